"""All that is true of lines that are driven one after the other while every sensed line has a load."""
