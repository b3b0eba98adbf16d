"""The programs of the vehicles, each with its framework's own library; none knows of uoarm."""
