"""Installs dgs_hand_driver as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "dgs_hand_driver"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Admittance control and CAN protocol of the DexHand Pro.",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "*.dbc", "*.yaml", "*.json", "*.dbc"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "hand_driver_node = dgs_hand_driver.hand_driver_node:main",
        ],
    },
)
