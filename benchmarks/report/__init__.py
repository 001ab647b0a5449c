"""What was measured, as stored, summed up, and put into tables, pictures and words."""
