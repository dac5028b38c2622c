/* What a panel's lines do to each other, by star-mesh elimination: shares no line and no method with the Python side. */
#ifndef LAMPEST_NETWORK_H
#define LAMPEST_NETWORK_H

#define NETWORK_MOST_LINES 32

/* Resistance between row line `row` and column line `column`, all other lines floating; `cells` is rows x columns in
 * ohm, row by row; infinite cells are open. Returns ohm, INFINITY where nothing joins the two lines. */
double network_resistance(const double *cells, int rows, int columns, int row, int column);

/* Share of the supply at column line `column` while row line `row` is joined to the supply through drive_ohm and every
 * column line to ground through its own of load_ohm (columns); the other row lines float. */
double network_share(const double *cells, int rows, int columns, int row, int column, double drive_ohm,
                     const double *load_ohm);

#endif
