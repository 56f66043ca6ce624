"""Installs dgs_ros as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "dgs_ros"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="What every node needs: base node, parameters, diagnostics, messages <-> numpy.",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    zip_safe=False,
)
