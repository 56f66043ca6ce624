"""Property-based fuzzing of everything that a user can hand in."""
