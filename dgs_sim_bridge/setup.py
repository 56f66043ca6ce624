"""Installs dgs_sim_bridge as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "dgs_sim_bridge"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="A PyBullet world that stands in for arm, hand and camera.",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "*.dbc", "*.yaml", "*.json", "data/**/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "sim_bridge_node = dgs_sim_bridge.sim_bridge_node:main",
        ],
    },
)
