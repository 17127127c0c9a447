# SPDX-License-Identifier: Apache-2.0
"""Build pneu_policy as an ament_python package with colcon; pip uses the root pyproject.toml."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

manifest = ElementTree.parse(Path(__file__).with_name("package.xml"))
package_name = "pneu_policy"

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
    description="Controllers of pneumatic pressure, their training, and the targets they follow",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "pid = pneu_policy.nodes.pid:main",
            "policy = pneu_policy.nodes.policy:main",
            "exercise = pneu_policy.nodes.exercise:main",
            "push = pneu_policy.nodes.push:main",
            "teleoperate = pneu_policy.nodes.teleoperate:main",
            "excite = pneu_policy.nodes.excite:main",
            "play = pneu_policy.nodes.play:main",
            "press = pneu_policy.nodes.press:main",
            "joint = pneu_policy.nodes.joint:main",
            "joint_target = pneu_policy.nodes.joint_target:main",
            "robot = pneu_policy.nodes.robot:main",
            "target = pneu_policy.nodes.target:main",
        ],
        "pneu.commands": ["5-policy = pneu_policy.commands:register"],
    },
)
