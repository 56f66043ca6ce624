"""What a dataset file holds: tables and contact sheets."""
