"""Installs dgs_grasp_planner as setup.cfg says."""

from setuptools import setup

setup()
