"""What the bridges see, what of it can be had, and candidates for functions with needs."""
