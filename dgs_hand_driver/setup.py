"""Installs dgs_hand_driver as setup.cfg says."""

from setuptools import setup

setup()
