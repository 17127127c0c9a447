// SPDX-License-Identifier: Apache-2.0
// Notes the first script error on the page element, where a reader's bug report and tests find it.
"use strict";
addEventListener("error", (event) => {
  document.documentElement.dataset.scriptError ??= String(event.message);
});
