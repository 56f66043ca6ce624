"""Installs dgs_perception as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "dgs_perception"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Depth camera, depth topics or a bag to one clean point cloud.",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "*.dbc", "*.yaml", "*.json", "data/**/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", ["config/extrinsics.yaml"]),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "calibrate_hand_eye = dgs_perception.calibrate_hand_eye:app",
            "camera_node = dgs_perception.camera_node:main",
            "cloud_recorder = dgs_perception.cloud_recorder_node:main",
        ],
    },
)
