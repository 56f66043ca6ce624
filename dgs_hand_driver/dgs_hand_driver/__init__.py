"""Admittance control and CAN protocol of the DexHand Pro."""
