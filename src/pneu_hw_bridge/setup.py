# SPDX-License-Identifier: Apache-2.0
"""Build pneu_hw_bridge as an ament_python package with colcon; pip uses the root pyproject.toml."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

manifest = ElementTree.parse(Path(__file__).with_name("package.xml"))
package_name = "pneu_hw_bridge"

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
    description="Bridge between the topics of a pneumatic rig and its hardware; emulated lab",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "valve_bridge = pneu_hw_bridge.nodes.valve_bridge:main",
            "kokoro_bridge = pneu_hw_bridge.nodes.valve_bridge:main",
            "phantom_bridge = pneu_hw_bridge.nodes.phantom_bridge:main",
            "hand_lab = pneu_hw_bridge.nodes.hand_lab:main",
        ],
        "pneu.commands": ["3-lab = pneu_hw_bridge.commands:register"],
        "pneu.at_once": ["stop = pneu_hw_bridge.stop_command:at_once"],
    },
)
