"""Style of pictures and pages: colors, opacities and the sizes of lines, points and letters."""

from __future__ import annotations

# Colors that people with any color vision tell apart (Okabe and Ito), in the order of use
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
TRUTH_COLOR = "#000000"  # a page with a dark background shows it in the color of its text
ESTIMATE_COLOR = "#0072B2"
FAILED_COLOR = "#D55E00"  # what truly fails
SUSPECT_COLOR = "#CC79A7"  # what the detector names
PLUME_COLOR = "#E69F00"  # a jet that does as it is told
UNTOLD_COLOR = "#B00020"  # of a failed one that fires untold
WITHHELD_COLOR = "#5A6675"  # of a failed one that was told to fire and does not
PAYLOAD_COLOR = "#009E73"
PATH_COLOR = "#2E8FC7"  # that the center of mass has flown
STAR_COLOR = "#6E7A8A"  # of stars or the floor, which do not turn with the vehicle
BAND_COLOR = "#9AA5B1"  # what surrounds a curve, and what stands behind the others
WINDOW_COLOR = "#E69F00"  # a hand controller is out of detent
UNARMED_COLOR = "#56636F"  # the detector is not armed
DECLARED_COLOR = "#D55E00"  # the detector declares a failure or a jump

SHOWN = 0.02  # of the full thrust; below it no healthy jet is shown to fire
LEAKS = 1e-4  # the same of a failed one

BAND_OPACITY = 0.35
WINDOW_OPACITY = 0.10
GRID_OPACITY = 0.25

# Widths and sizes in points
LINE_WIDTH = 1.1
THIN_LINE = 0.9
POINT_SIZE = 4.0
TITLE_SIZE = 11.0
LABEL_SIZE = 9.0
KEY_SIZE = 8.0
ROW_SIZE = 7.0  # of the names of many rows
WINDOW_SIZE = 6.0  # of the names of windows

DOTS_PER_INCH = 100
