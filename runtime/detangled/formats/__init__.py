"""Reading and writing grooms: one file a format."""
