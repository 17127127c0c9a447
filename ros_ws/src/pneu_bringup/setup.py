# SPDX-License-Identifier: Apache-2.0
"""Install launch files, parameters, layouts and the rig with colcon; there is no Python in it."""

import xml.etree.ElementTree as ElementTree
from glob import glob
from pathlib import Path

from setuptools import setup

manifest = ElementTree.parse(Path(__file__).with_name("package.xml"))
package_name = "pneu_bringup"

setup(
    name=package_name,
    version=manifest.findtext("version"),
    packages=[],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        # A link to a rig file is followed, so that the file itself is installed.
        *((f"share/{package_name}/{d}", glob(f"{d}/*")) for d in ("launch", "config", "layouts")),
        (f"share/{package_name}/rigs", glob("rigs/*.yaml")),
        (f"share/{package_name}/scenes/phantom", glob("scenes/phantom/*")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The Pneu developers",
    maintainer_email="noreply@pneu.invalid",
    description="Launch files, parameters and viewer layouts of a live pneumatic rig",
    license="Apache-2.0",
)
