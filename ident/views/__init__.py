"""What is shown of each result: its tables, which terminal, notebook and page render each in their way."""
