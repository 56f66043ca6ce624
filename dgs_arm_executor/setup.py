"""Installs dgs_arm_executor as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "dgs_arm_executor"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Inverse kinematics, planning scene and trajectories: executes a predicted grasp.",
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
            "arm_executor_node = dgs_arm_executor.arm_executor_node:main",
            "check_extrinsics = dgs_arm_executor.check_extrinsics_node:main",
        ],
    },
)
