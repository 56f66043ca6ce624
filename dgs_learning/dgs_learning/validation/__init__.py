"""Re-simulation of stored grasps: do the numbers in the file still hold?"""
