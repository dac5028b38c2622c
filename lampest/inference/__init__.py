"""What a recording tells of its circuit, its noise and its effects, before cells are estimated."""
