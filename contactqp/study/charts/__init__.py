"""What a report draws: plain data for Plotly, with a caption and its numbers as a table."""
