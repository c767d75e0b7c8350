"""Both views of a pair as measurements of the joints: which, how far off, how far to trust them."""
