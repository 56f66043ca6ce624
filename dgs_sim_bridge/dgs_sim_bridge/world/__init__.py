"""The simulated world: physics, scenes, arm and hand motors, camera."""
