# SPDX-License-Identifier: Apache-2.0
"""Build pneu_common as an ament_python package with colcon; pip uses the root pyproject.toml."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

manifest = ElementTree.parse(Path(__file__).with_name("package.xml"))
package_name = "pneu_common"

setup(
    name=package_name,
    version=manifest.findtext("version"),
    packages=find_packages(include=[package_name, f"{package_name}.*"]),
    package_data={
        "": ["py.typed", "**/*.yaml", "**/*.html", "**/*.css", "**/*.js", "**/*.json"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="The Pneu developers",
    maintainer_email="noreply@pneu.invalid",
    description="What every package of Pneu stands on, and the pneu command",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["pneu = pneu_common.entry:main"],
    },
)
