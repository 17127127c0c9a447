# SPDX-License-Identifier: Apache-2.0
"""Build pneu_sim as an ament_python package with colcon; pip uses the root pyproject.toml."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

manifest = ElementTree.parse(Path(__file__).with_name("package.xml"))
package_name = "pneu_sim"

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
    description="Gas-dynamic and lumped simulation of pneumatic valves, tubes and chambers",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "simulator = pneu_sim.nodes.simulator:main",
            "hand_simulator = pneu_sim.nodes.hand_simulator:main",
            "observer = pneu_sim.nodes.observer:main",
            "robot_view = pneu_sim.nodes.robot_view:main",
        ],
        "pneu.commands": ["1-sim = pneu_sim.commands:register"],
    },
)
