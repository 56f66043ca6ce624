"""Installs dgs_grasp_planner as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "dgs_grasp_planner"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="DGS-Net: dexterous grasps for every object of a single-view point cloud.",
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
            "grasp_planner_node = dgs_grasp_planner.grasp_planner_node:main",
        ],
    },
)
