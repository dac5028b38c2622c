"""Live estimation of frames as they arrive.

They are shown on a page in the browser and published for other programs.
"""
