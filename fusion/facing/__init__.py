"""Front and back, left and right: which labels each view has exchanged (end of sec. 5 of the paper)."""
