"""Attacks on lampest: hostile files, names, values and places.

The mark `soak` tries them by the thousand.
"""
