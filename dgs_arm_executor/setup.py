"""Installs dgs_arm_executor as setup.cfg says."""

from setuptools import setup

setup()
