"""All that is true while every line floats but two: R = Z_jj + Z_kk − 2 Z_jk and what follows from it."""
