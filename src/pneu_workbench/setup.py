# SPDX-License-Identifier: Apache-2.0
"""Build pneu_workbench as an ament_python package with colcon; pip uses the root pyproject.toml."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

manifest = ElementTree.parse(Path(__file__).with_name("package.xml"))
package_name = "pneu_workbench"

setup(
    name=package_name,
    version=manifest.findtext("version"),
    packages=find_packages(include=[package_name, f"{package_name}.*"]),
    package_data={"": ["py.typed", "static/**/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="The Pneu developers",
    maintainer_email="noreply@pneu.invalid",
    description="A local page on which a model is compared with recordings, and mended",
    license="Apache-2.0",
    entry_points={"pneu.commands": ["6-workbench = pneu_workbench.command:register"]},
)
