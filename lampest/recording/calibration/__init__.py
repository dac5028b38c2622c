"""What the electronics are, from recordings of known resistors in place of the cells."""
