"""What is shown of finished runs: the HTML page, tables in documents, the model card."""
