# SPDX-License-Identifier: Apache-2.0
"""Build pneu_graph as an ament_python package with colcon; pip uses the root pyproject.toml."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

manifest = ElementTree.parse(Path(__file__).with_name("package.xml"))
package_name = "pneu_graph"

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
    description="Bags, launch files and tools of the ROS graph, and what all nodes do alike",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "player = pneu_graph.nodes.player:main",
            "recorder = pneu_graph.nodes.recorder:main",
        ],
        "pneu.commands": ["4-graph = pneu_graph.commands:register"],
    },
)
