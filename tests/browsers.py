# SPDX-License-Identifier: Apache-2.0
"""The browser that pages are opened in by tests, where one is installed."""

import shutil

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
BROWSER = next((path for name in NAMES if (path := shutil.which(name))), None)
"""Its path; None where there is none."""
WITHOUT = f"none of {', '.join(NAMES)} is here: `apt-get install chromium` brings one"
"""Why a test is left out then."""
