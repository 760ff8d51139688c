# pyright: standard
"""Compiled inner loops of warping: what stands at a pixel of the target, patch by patch.

In a patch the mapping from the target to the source is bilinear; see :mod:`planish.resample.patches`. All kernels get
a ``window`` (rows, cols) of the source that holds what lies under their patches, with the row ``r0`` and the column
``c0`` of the whole source that it begins at, and ``known`` (rows, cols) uint8 of the same window, or (0, 0) where every
pixel of it is known. They write ``out`` and ``valid`` (uint8), which begin at the row ``y0`` and the column ``x0`` of
the target. Images and ``out`` are float64. What a patch gets depends on nothing but the patch and the source under it.
"""

import numpy as np
from numba import njit

_EDGE = 1e-9  # of the weights: a pixel of the source with less does not count, so none is lost to rounding
_FINE = 40  # bits of a pixel: places are whole multiples of 2^-40 of it
_FLAT = 1e-6  # of the square of its diagonal: an area below that is none
# A number written in a call would be a type of its own, and the callee compiled once more.
_ZERO, _ONE = np.int64(0), np.int64(1)


@njit(cache=True, nogil=True, error_model="numpy")
def _box(corner):
    """Least and greatest x and y of a patch's corners (2, 2, 2)."""
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for i in range(2):
        for j in range(2):
            x, y = corner[i, j, 0], corner[i, j, 1]
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
    return low_x, low_y, high_x, high_y


@njit(cache=True, nogil=True, error_model="numpy")
def _side(corner, t):
    """Place of the left end at the share ``t`` of a patch's height, and the way to the right end."""
    lx = corner[0, 0, 0] + t * (corner[1, 0, 0] - corner[0, 0, 0])
    ly = corner[0, 0, 1] + t * (corner[1, 0, 1] - corner[0, 0, 1])
    rx = corner[0, 1, 0] + t * (corner[1, 1, 0] - corner[0, 1, 0])
    ry = corner[0, 1, 1] + t * (corner[1, 1, 1] - corner[0, 1, 1])
    return lx, ly, rx - lx, ry - ly


@njit(cache=True, nogil=True, error_model="numpy")
def _all_known(known, top, bottom, left, right):
    """Whether the pixels of a window from ``top`` to ``bottom`` and ``left`` to ``right``, both included, are."""
    if known.shape[0] == 0:
        return True
    for i in range(max(top, 0), min(bottom + 1, known.shape[0])):
        for j in range(max(left, 0), min(right + 1, known.shape[1])):
            if known[i, j] == 0:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _within(first, step, limit, begin, end):
    """Part of the range ``begin`` to ``end`` in which ``0 <= first + k * step < limit``; it may be empty."""
    low, high = -first, limit - first  # low <= k * step < high
    if step < 0:
        low, high, step = 1 - high, 1 - low, -step
    if step == 0:
        return (begin, end) if low <= 0 < high else (begin, begin)
    begin = max(begin, -(-low // step))
    return begin, max(begin, min(end, -(-high // step)))


@njit(cache=True, nogil=True, error_model="numpy")
def _with_care(window, known, m, n, v, u):
    """Bilinear value at the shares ``v`` and ``u`` from pixel (m, n); NaN where one that has weight is not known."""
    total = 0.0
    for q in range(4):
        y, x = m + (q >> 1), n + (q & 1)
        weight = (v if q >> 1 else 1.0 - v) * (u if q & 1 else 1.0 - u)
        if weight <= _EDGE:
            continue
        if y < 0 or x < 0 or y >= window.shape[0] or x >= window.shape[1]:
            return np.nan
        if known.shape[0] > 0 and known[y, x] == 0:
            return np.nan
        total += weight * window[y, x]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def interpolate(window, r0, c0, known, bounds, corners, out, valid, y0, x0):
    """Bilinear values at the middles; a pixel is left as it is where one around it that has weight is not known."""
    unit = 2.0**_FINE
    per = 1.0 / unit
    mask = (np.int64(1) << _FINE) - 1
    rows, cols = window.shape
    wide = np.uint64(cols)
    one = np.uint64(1)
    flat = window.reshape(-1)
    shift_x, shift_y = np.int64(c0) << _FINE, np.int64(r0) << _FINE
    for p in range(bounds.shape[0]):
        top, bottom, left, right = bounds[p, 0], bounds[p, 1], bounds[p, 2], bounds[p, 3]
        corner = corners[p]
        height, width = bottom - top, right - left
        low_x, low_y, high_x, high_y = _box(corner)
        first, last = int(np.floor(low_y)) - r0, int(np.floor(high_y)) + 1 - r0
        quick = _all_known(known, first, last, int(np.floor(low_x)) - c0, int(np.floor(high_x)) + 1 - c0)
        for i in range(height):
            lx, ly, wx, wy = _side(corner, (i + 0.5) / height)
            # Whole numbers: the same place whatever the window, and no conversion back and forth in the loop.
            step_x, step_y = np.int64(np.rint(wx / width * unit)), np.int64(np.rint(wy / width * unit))
            at_x = np.int64(np.rint((lx + 0.5 * wx / width) * unit)) - shift_x
            at_y = np.int64(np.rint((ly + 0.5 * wy / width) * unit)) - shift_y
            row, good = out[top - y0 + i], valid[top - y0 + i]
            begin, end = 0, 0
            if quick:
                begin, end = _within(at_x, step_x, np.int64(cols - 1) << _FINE, _ZERO, width)
                begin, end = _within(at_y, step_y, np.int64(rows - 1) << _FINE, begin, end)
            for k in range(begin, end):
                x, y = at_x + k * step_x, at_y + k * step_y
                at = np.uint64(y >> _FINE) * wide + np.uint64(x >> _FINE)
                u, v = (x & mask) * per, (y & mask) * per
                a, b = flat[at], flat[at + one]
                c, d = flat[at + wide], flat[at + wide + one]
                a += u * (b - a)
                c += u * (d - c)
                row[left - x0 + k] = a + v * (c - a)
                good[left - x0 + k] = 1
            for side in range(2):
                for k in range(end if side else 0, width if side else begin):
                    x, y = at_x + k * step_x, at_y + k * step_y
                    value = _with_care(window, known, y >> _FINE, x >> _FINE, (y & mask) * per, (x & mask) * per)
                    if value == value:
                        row[left - x0 + k] = value
                        good[left - x0 + k] = 1


@njit(cache=True, nogil=True, error_model="numpy")
def take(window, r0, c0, known, bounds, corners, out, valid, y0, x0):
    """Value of the pixel in which the middle of each pixel lies, bit by bit; left as it is where that is not known."""
    rows, cols = window.shape
    for p in range(bounds.shape[0]):
        top, bottom, left, right = bounds[p, 0], bounds[p, 1], bounds[p, 2], bounds[p, 3]
        height, width = bottom - top, right - left
        for i in range(height):
            lx, ly, wx, wy = _side(corners[p], (i + 0.5) / height)
            for k in range(width):
                t = (k + 0.5) / width
                y = np.int64(np.floor(ly + t * wy + 0.5)) - r0
                x = np.int64(np.floor(lx + t * wx + 0.5)) - c0
                if y < 0 or x < 0 or y >= rows or x >= cols or (known.shape[0] > 0 and known[y, x] == 0):
                    continue
                out[top - y0 + i, left - x0 + k] = window[y, x]
                valid[top - y0 + i, left - x0 + k] = 1


@njit(cache=True, nogil=True, error_model="numpy")
def _under(sums, stride, x0, y0, x1, y1, slope):
    """Integral over x, along a straight line, of the integral over y of an image from row 0 down to the line.

    ``sums`` (rows + 1 times ``stride``) holds the sums of the pixels above each row; pixel (r, c) reaches from x = c to
    c + 1 and from y = r to r + 1. In a pixel what is integrated is linear in y, so its value at the middle of the piece
    of the line that lies in the pixel is exact. ``slope`` is dy / dx.
    """
    dx, dy = x1 - x0, y1 - y0
    if dx == 0.0:
        return 0.0
    c, r, last, end = int(x0), int(y0), int(x1), int(y1)
    at = r * stride + c
    # Most lines are short and nearly along an axis: they stay in a row or in a column.
    if r == end:
        # Depth in the row at the middle of a piece, less what the piece's ends add to it.
        deep = y0 - r - slope * x0
        slope *= 0.5
        total = 0.0
        way = 1 if last > c else -1
        ahead = max(way, 0)
        while c != last:
            there = float(c + ahead)
            base = sums[np.uint64(at)]
            total += (there - x0) * (base + (deep + slope * (x0 + there)) * (sums[np.uint64(at + stride)] - base))
            x0 = there
            c += way
            at += way
        base = sums[np.uint64(at)]
        return total + (x1 - x0) * (base + (deep + slope * (x0 + x1)) * (sums[np.uint64(at + stride)] - base))
    if c == last:
        total = 0.0
        way = 1 if end > r else -1
        ahead = max(way, 0)
        while r != end:
            there = float(r + ahead)
            base = sums[np.uint64(at)]
            total += (there - y0) * (base + (0.5 * (y0 + there) - r) * (sums[np.uint64(at + stride)] - base))
            y0 = there
            r += way
            at += way * stride
        base = sums[np.uint64(at)]
        total += (y1 - y0) * (base + (0.5 * (y0 + y1) - r) * (sums[np.uint64(at + stride)] - base))
        return total * (dx / dy)
    # Shares of the line at which it enters the next column, and the next row.
    cols, rows = abs(last - c), abs(end - r)
    step_x, step_y = abs(1.0 / dx), abs(1.0 / dy)
    way_c, next_x = (1, (c + 1 - x0) * step_x) if last > c else (-1, (x0 - c) * step_x)
    way_r, next_y = (1, (r + 1 - y0) * step_y) if end > r else (-1, (y0 - r) * step_y)
    total, now = 0.0, 0.0
    half = 0.5 * dy
    while cols > 0 or rows > 0:
        across = rows == 0 or (cols > 0 and next_x <= next_y)
        then = next_x if across else next_y
        base = sums[np.uint64(at)]
        total += (then - now) * (base + (y0 - r + (now + then) * half) * (sums[np.uint64(at + stride)] - base))
        now = then
        if across:
            next_x += step_x
            at += way_c
            cols -= 1
        else:
            next_y += step_y
            at += way_r * stride
            r += way_r
            rows -= 1
    base = sums[np.uint64(at)]
    total += (1.0 - now) * (base + (y0 - r + (now + 1.0) * half) * (sums[np.uint64(at + stride)] - base))
    return dx * total


@njit(cache=True, nogil=True, error_model="numpy")
def _add_up(window, known, top, left, rows, cols, sums, stride, counted):
    """Sums down the columns of the part of the window that begins at ``top``, ``left``; nothing beside the window.

    Of its values, or where ``counted`` is 1 of the number of known pixels.
    """
    for j in range(cols):
        sums[j] = 0.0
    masked = known.shape[0] > 0
    first, last = max(-left, 0), min(window.shape[1] - left, cols)
    for i in range(rows):
        y, at = top + i, i * stride
        for j in range(cols):
            sums[at + stride + j] = sums[at + j]
        if 0 <= y < window.shape[0]:
            for j in range(first, last):
                if not masked or known[y, left + j]:
                    sums[at + stride + j] += 1.0 if counted > 0 else window[y, left + j]


@njit(cache=True, nogil=True, error_model="numpy")
def average(window, r0, c0, known, bounds, corners, out, valid, y0, x0):
    """Mean over the quadrilateral that each pixel's outline becomes in the source.

    A pixel of the source counts with the area of it that lies inside, exactly: the integral over the quadrilateral is
    the one along its four sides (Green), and neighbours share their sides. A pixel is left as it is where less than
    half of its area is known.
    """
    count = bounds.shape[0]
    boxes = np.empty((count, 4), np.int64)
    most_rows, most_cols, most_width = _ZERO, _ZERO, _ZERO
    for p in range(count):
        low_x, low_y, high_x, high_y = _box(corners[p])
        # A row and a column more on every side, for the last digit.
        boxes[p, 0], boxes[p, 1] = int(np.floor(low_y + 0.5)) - 1, int(np.floor(low_x + 0.5)) - 1
        boxes[p, 2], boxes[p, 3] = int(np.floor(high_y + 0.5)) + 2, int(np.floor(high_x + 0.5)) + 2
        most_rows = max(most_rows, boxes[p, 2] - boxes[p, 0])
        most_cols = max(most_cols, boxes[p, 3] - boxes[p, 1])
        most_width = max(most_width, bounds[p, 3] - bounds[p, 2])
    stride = most_cols
    sums = np.empty((most_rows + 1) * stride)
    weights = np.empty(0)
    above = np.empty((3, most_width))  # of each pixel's upper side and both others: values, what is known, area
    for p in range(count):
        top, bottom, left, right = bounds[p, 0], bounds[p, 1], bounds[p, 2], bounds[p, 3]
        height, width = bottom - top, right - left
        by, bx = boxes[p, 0], boxes[p, 1]
        rows, cols = boxes[p, 2] - by, boxes[p, 3] - bx
        whole = by >= r0 and bx >= c0 and by + rows <= r0 + window.shape[0] and bx + cols <= c0 + window.shape[1]
        whole = whole and _all_known(known, by - r0, by + rows - 1 - r0, bx - c0, bx + cols - 1 - c0)
        _add_up(window, known, by - r0, bx - c0, rows, cols, sums, stride, _ZERO)
        if not whole:
            if weights.shape[0] == 0:
                weights = np.empty(sums.shape)
            _add_up(window, known, by - r0, bx - c0, rows, cols, weights, stride, _ONE)
        for i in range(height + 1):
            lx, ly, wx, wy = _side(corners[p], i / height)
            nx, ny, vx, vy = _side(corners[p], (i + 1) / height)
            # From the border of the box, where a pixel begins at a whole number.
            lx, nx = lx + 0.5 - bx, nx + 0.5 - bx
            ly, ny = ly + 0.5 - by, ny + 0.5 - by
            wx, wy, vx, vy = wx / width, wy / width, vx / width, vy / width
            slope = wy / wx if wx != 0.0 else 0.0
            ax, ay, fx, fy = lx, ly, nx, ny
            # Down the left side of the row's first pixel; later ones have that of their neighbour.
            side = side_known = side_area = 0.0
            if i < height:
                tilt = (fy - ay) / (fx - ax) if fx != ax else 0.0
                side = _under(sums, stride, ax, ay, fx, fy, tilt)
                side_area = 0.5 * (ay + fy) * (fx - ax)
                if not whole:
                    side_known = _under(weights, stride, ax, ay, fx, fy, tilt)
            for k in range(width):
                cx, cy = lx + (k + 1) * wx, ly + (k + 1) * wy
                along = _under(sums, stride, ax, ay, cx, cy, slope)
                along_area = 0.5 * (ay + cy) * (cx - ax)
                along_known = 0.0 if whole else _under(weights, stride, ax, ay, cx, cy, slope)
                if i > 0:
                    total, area = above[0, k] - along, above[2, k] - along_area
                    part = area if whole else above[1, k] - along_known
                    if abs(area) > 0.0 and part / area >= 0.5 - _EDGE:  # not where the area is NaN
                        out[top - y0 + i - 1, left - x0 + k] = total / part
                        valid[top - y0 + i - 1, left - x0 + k] = 1
                if i < height:
                    ex, ey = nx + (k + 1) * vx, ny + (k + 1) * vy
                    p0, q0, p1, q1 = ex - ax, ey - ay, cx - fx, cy - fy
                    folded = abs(p0 * q1 - p1 * q0) <= _FLAT * max(p0 * p0 + q0 * q0, p1 * p1 + q1 * q1)
                    tilt = (ey - cy) / (ex - cx) if ex != cx else 0.0
                    above[0, k], above[1, k], above[2, k] = (
                        along - side,
                        along_known - side_known,
                        along_area - side_area,
                    )
                    side = _under(sums, stride, cx, cy, ex, ey, tilt)
                    side_area = 0.5 * (cy + ey) * (ex - cx)
                    side_known = 0.0 if whole else _under(weights, stride, cx, cy, ex, ey, tilt)
                    above[0, k] += side
                    above[1, k] += side_known
                    above[2, k] = np.nan if folded else above[2, k] + side_area
                    fx, fy = ex, ey
                ax, ay = cx, cy
