"""The networks: their files, fetching them, and running them."""
