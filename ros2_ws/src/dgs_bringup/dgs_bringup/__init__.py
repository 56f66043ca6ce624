"""Launch files, parameters, scripts and the task that clears a table."""
