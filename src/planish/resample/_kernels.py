# pyright: standard
"""Compiled inner loops of resampling.

They find which triangle covers a pixel and what stands there, and sums over areas.

A quad with the corners 0 = (0, 0), 1 = (0, 1), 2 = (1, 1), 3 = (1, 0) in (row, column) is cut along
0-2 into the triangles 0-1-2 and 0-2-3. Triangle t of the quad whose first corner is node n of the
mesh has the number 2 n + t. Kernels of triangles work on the rows ``begin`` to ``end`` of their
output only, so that several may run at the same time; no result depends on how the rows are shared
out.
"""

import numpy as np

from planish.core._cubic_kernels import cubic_value
from planish.core.jit import njit

_EDGE = 1e-9  # of a triangle's weights: a pixel on a common edge is never lost to rounding
_SAME = 1e-6  # of a quad: what two quads with a common edge may differ in about a pixel on it


@njit(cache=True, nogil=True)
def _shares(number, wb, wc):
    """Shares of the way across a triangle's quad, along the rows' index and the columns'."""
    return (wb + wc, wb) if number & 1 else (wc, wb + wc)


@njit(cache=True, nogil=True)
def _place(number, wb, wc, cols):
    """Row and column, with fractions, of a place in a triangle of the mesh."""
    node = number >> 1
    i = node // cols
    j = node - i * cols
    row_share, col_share = _shares(number, wb, wc)
    return i + row_share, j + col_share


@njit(cache=True, nogil=True)
def _on_target(uv, i, j, first, pitch):
    """Place of a node in pixels of the target."""
    u, v = uv[i, j, 0] - first[0], uv[i, j, 1] - first[1]
    return u * (1.0 / pitch[0]), v * (1.0 / pitch[1])


@njit(cache=True, nogil=True)
def _weights(area, nb, nc):
    """Weights of a triangle's second and third corner, from these times the area; -1 outside.

    The area is twice that of the triangle, negative where it is turned over. A place on its border,
    to 1e-9 of it, lies inside.
    """
    if area < 0.0:
        area, nb, nc = -area, -nb, -nc
    slack = _EDGE * area
    # The area is divided by only where it is known that the pixel is inside.
    if not (area > 0.0 and nb >= -slack and nc >= -slack and nb + nc <= area + slack):
        return -1.0, -1.0
    inverse = 1.0 / area
    wb = max(nb * inverse, 0.0)
    wc = max(nc * inverse, 0.0)
    if wb + wc > 1.0:
        wb, wc = wb / (wb + wc), wc / (wb + wc)
    return wb, wc


@njit(cache=True, nogil=True)
def locate(uv, first, pitch, segment, low, high, triangle, weight, twice, begin, end):  # noqa: C901, PLR0912
    """Find, for every pixel of a regular grid, the triangle of a quad mesh that it lies in.

    uv                 : (rows, cols, 2), flat coordinates of the nodes; not finite where there is
                         none
    first, pitch       : (2), (u, v) of the centre of the target's first pixel, and from one pixel
                         to the next
    segment, low, high : int, (rows, segments), (rows, segments): extent of the nodes ``s *
                         segment`` to ``(s + 1) * segment``, both included, of each row, in rows of
                         the target
    triangle           : (rows_out, cols_out) int32, set to the number of the triangle; -1 where
                         there is no quad. Where quads overlap, the first one stays
    weight             : (2, rows_out, cols_out), set to the weights of the triangle's second and
                         third corner; the first one has what is left of 1
    twice              : (rows_out, cols_out) uint8, zeros; set to 1 where more than one quad lies
    begin, end         : rows of the target to do

    Gives the number of pixels on which more than one quad lies.
    """
    rows, cols = uv.shape[:2]
    width = triangle.shape[1]
    count = 0
    for y in range(begin, end):
        for x in range(width):
            triangle[y, x] = -1
    for i in range(rows - 1):
        for s in range(low.shape[1]):
            segment_low = min(low[i, s], low[i + 1, s])
            segment_high = max(high[i, s], high[i + 1, s])
            if segment_low - _EDGE > end - 1 or segment_high + _EDGE < begin:
                continue
            start = s * segment
            # Corners of the quad: a = 0, b = 1, c = 2, d = 3; b and c are a and d of the next one.
            bx, by = _on_target(uv, i, start, first, pitch)
            cx, cy = _on_target(uv, i + 1, start, first, pitch)
            for j in range(start, min(start + segment, cols - 1)):
                ax, ay, dx, dy = bx, by, cx, cy
                bx, by = _on_target(uv, i, j + 1, first, pitch)
                cx, cy = _on_target(uv, i + 1, j + 1, first, pitch)
                total = (ax + bx) + (cx + dx) + ((ay + by) + (cy + dy))
                if total - total != 0.0:  # a corner is missing
                    continue
                top = max(np.ceil(min(ay, by, cy, dy) - _EDGE), float(begin))
                bottom = min(np.floor(max(ay, by, cy, dy) + _EDGE), end - 1.0)
                left = max(np.ceil(min(ax, bx, cx, dx) - _EDGE), 0.0)
                right = min(np.floor(max(ax, bx, cx, dx) + _EDGE), width - 1.0)
                if top > bottom or left > right:
                    continue
                ex, ey = bx - ax, by - ay
                fx, fy = cx - ax, cy - ay
                gx, gy = dx - ax, dy - ay
                # Twice the area of 0-1-2, and of 0-2-3: negative when turned over.
                upper = ex * fy - fx * ey
                lower = fx * gy - gx * fy
                number = 2 * (i * cols + j)
                for y in range(int(top), int(bottom) + 1):
                    q = y - ay
                    for x in range(int(left), int(right) + 1):
                        p = x - ax
                        across = p * fy - fx * q
                        t = 0
                        wb, wc = _weights(upper, across, ex * q - p * ey)
                        if wb < 0.0:
                            t = 1
                            wb, wc = _weights(lower, p * gy - gx * q, -across)
                        if wb < 0.0:
                            continue
                        if triangle[y, x] < 0:
                            triangle[y, x] = number + t
                            weight[0, y, x] = wb
                            weight[1, y, x] = wc
                        elif twice[y, x] == 0:
                            before = np.int64(triangle[y, x])
                            r0, c0 = _place(before, weight[0, y, x], weight[1, y, x], cols)
                            r1, c1 = _place(number + t, wb, wc, cols)
                            if abs(r0 - r1) > _SAME or abs(c0 - c1) > _SAME:
                                twice[y, x] = 1
                                count += 1
    return count


@njit(cache=True, nogil=True)
def _corners(number, corners, cols):
    """Numbers of the three nodes of a triangle: from the list, or of its quad in a mesh of cols."""
    if corners.shape[0] > 0:
        nodes = corners[number]
        return np.int64(nodes[0]), np.int64(nodes[1]), np.int64(nodes[2])
    node = np.int64(number) >> 1
    half = np.int64(number) & 1
    return node, node + 1 + half * cols, node + 1 + cols - half


@njit(cache=True, nogil=True)
def _value(field, a, b, c, wb, wc):
    """Linear value in a triangle of nodes; NaN where a corner with weight is.

    ``a``, ``b`` and ``c`` are the numbers of its corners in ``field``, ``wb`` and ``wc`` the
    weights of the last two.
    """
    fa, fb, fc = field[a], field[b], field[c]
    value = fa + (wb * (fb - fa) + wc * (fc - fa))
    if value == value:
        return value
    # A corner without weight may be missing: a node on the border of the sheet keeps its own value.
    wa = 1.0 - wb - wc
    value = 0.0
    if wa > _EDGE:
        value += wa * fa
    if wb > _EDGE:
        value += wb * fb
    if wc > _EDGE:
        value += wc * fc
    return value


@njit(cache=True, nogil=True, inline="always")
def _cubic(lattice, number, wb, wc):
    """Value of a field (rows, cols) in a triangle of its quads, by cubic convolution."""
    node = np.int64(number) >> 1
    i = node // lattice.shape[1]
    j = node - i * lattice.shape[1]
    row_share, col_share = _shares(number, wb, wc)
    return cubic_value(lattice, i, j, row_share, col_share)


@njit(cache=True, nogil=True)
def find_bends(u, v, triangle, weight, bend, begin, end):
    """Set how far cubic convolution of the coordinates themselves leads past each pixel.

    A mesh of parallelograms leads to the pixel; on any other, what is affine in the plane stays so
    once this is taken off.

    u, v       : (rows, cols), flat coordinates of the nodes
    triangle   : (rows_out, cols_out) int32, as :func:`locate` sets it
    weight     : (2, rows_out, cols_out), as :func:`locate` sets it
    bend       : (2, rows_out, cols_out), set to what the weights of the triangle's second and third
                 corner would have to be more for that; NaN where one of the four by four nodes
                 around is missing, or where it leads past by more than a side of the triangle
    begin, end : rows of ``bend`` to do
    """
    cols = u.shape[1]
    u_nodes = u.reshape(-1)
    v_nodes = v.reshape(-1)
    no_corners = np.empty((0, 3), np.int32)
    for y in range(begin, end):
        for x in range(bend.shape[2]):
            bend[0, y, x] = np.nan
            bend[1, y, x] = np.nan
            number = triangle[y, x]
            if number < 0:
                continue
            wb, wc = weight[0, y, x], weight[1, y, x]
            a, b, c = _corners(number, no_corners, cols)
            au, av = u_nodes[a], v_nodes[a]
            bu, bv = u_nodes[b] - au, v_nodes[b] - av
            cu, cv = u_nodes[c] - au, v_nodes[c] - av
            past_u = _cubic(u, number, wb, wc) - (au + (wb * bu + wc * cu))
            past_v = _cubic(v, number, wb, wc) - (av + (wb * bv + wc * cv))
            area = bu * cv - cu * bv
            across_b = past_u * cv - cu * past_v
            across_c = bu * past_v - past_u * bv
            # Past a triangle that is all but flat, or a whole side: nothing is known of the curve.
            if area != 0.0 and max(abs(across_b), abs(across_c)) <= abs(area):
                bend[0, y, x] = across_b / area
                bend[1, y, x] = across_c / area


@njit(cache=True, nogil=True)
def sample(field, triangle, weight, bend, corners, fine, out, share, begin, end):
    """Set ``out`` to a field's mean over each pixel's known sub-pixels, ``share`` to their share.

    In a mesh of quads, values between nodes are those of cubic convolution where four by four nodes
    are known. In other triangles, and elsewhere, they are linear.

    field      : (rows, cols), values at the nodes of the mesh; NaN is missing
    triangle   : (rows_out * fine, cols_out * fine), as :func:`locate` sets it
    weight     : (2, rows_out * fine, cols_out * fine), as :func:`locate` sets it
    bend       : (2, rows_out * fine, cols_out * fine), as :func:`find_bends` sets it; without rows
                 for other triangles than those of the quads
    corners    : (triangles, 3) int32, nodes of each triangle; without rows for the triangles of the
    quads
    fine       : sub-pixels per pixel and axis
    out, share : (rows_out, cols_out); ``out`` NaN where less than half the sub-pixels are known;
    ``share`` may be empty
    begin, end : rows of ``out`` to do
    """
    nodes = field.reshape(-1)
    for y in range(begin, end):
        for x in range(out.shape[1]):
            total = 0.0
            known = 0
            for m in range(y * fine, (y + 1) * fine):
                for n in range(x * fine, (x + 1) * fine):
                    number = triangle[m, n]
                    if number < 0:
                        continue
                    wb, wc = weight[0, m, n], weight[1, m, n]
                    a, b, c = _corners(number, corners, field.shape[1])
                    value = np.nan
                    if bend.shape[1] > 0:
                        past = bend[0, m, n] * (nodes[b] - nodes[a])
                        past += bend[1, m, n] * (nodes[c] - nodes[a])
                        value = _cubic(field, number, wb, wc) - past
                    if value != value:
                        value = _value(nodes, a, b, c, wb, wc)
                    if value == value:
                        total += value
                        known += 1
            out[y, x] = total / known if known > 0 and 2 * known >= fine * fine else np.nan
            if share.size:
                share[y, x] = known / (fine * fine)


@njit(cache=True, nogil=True)
def _sum_of(nodes, weights):
    """Sum of four places, (x, y), with their weights."""
    x = y = 0.0
    for a in range(4):
        x += nodes[a, 0] * weights[a]
        y += nodes[a, 1] * weights[a]
    return x, y


@njit(cache=True, nogil=True)
def interpolate(image, nodes, down, across, least, out):
    """Set ``out`` to bilinear values of an image at places that are polynomials.

    The polynomials are of third degree in each direction.

    image        : (height, width); what is not finite is missing
    nodes        : (4, 4, 2), places, (x, y) in pixels of the image, that the polynomials go through
    down, across : (rows, 4), (cols, 4), weights of the nodes for each row and each column of
    ``out``, (rows, cols)
    least        : share of the weight of the pixels around a place that has to be known; otherwise
    NaN
    """
    height, width = image.shape
    for r in range(out.shape[0]):
        in_row = np.zeros((4, 2))
        for a in range(4):
            in_row += down[r, a] * nodes[a]
        for c in range(out.shape[1]):
            x, y = _sum_of(in_row, across[c])
            left = int(np.floor(x))
            top = int(np.floor(y))
            fx, fy = x - left, y - top
            total, share = 0.0, 0.0
            if left >= 0 and top >= 0 and left < width - 1 and top < height - 1:
                a = np.float64(image[top, left])
                b = np.float64(image[top, left + 1])
                e = np.float64(image[top + 1, left])
                f = np.float64(image[top + 1, left + 1])
                upper = a * (1.0 - fx) + b * fx
                lower = e * (1.0 - fx) + f * fx
                total = upper * (1.0 - fy) + lower * fy
                if np.isfinite(total):
                    out[r, c] = total
                    continue
                total = 0.0
            for i in range(2):
                for j in range(2):
                    if 0 <= top + i < height and 0 <= left + j < width:
                        value = np.float64(image[top + i, left + j])
                        if np.isfinite(value):
                            w = (fy if i else 1.0 - fy) * (fx if j else 1.0 - fx)
                            total += w * value
                            share += w
            out[r, c] = total if share >= least else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _under(sums, x0, y0, x1, y1):
    """Integrate an image from row 0 down to a straight line.

    The integral over y, from row 0 down to the line, is integrated over x along the line.

    Linear in y within a pixel, so the value at the middle of the line's piece in it is exact.
    """
    dx, dy = x1 - x0, y1 - y0
    if dx == 0.0:
        return 0.0
    c = int(x0)
    r = int(y0)
    cols = abs(int(x1) - c)
    rows = abs(int(y1) - r)
    # Shares of the line at which it enters the next column, and the next row.
    step_x = abs(1.0 / dx)
    step_y = abs(1.0 / dy)
    to_c, next_x = (1, (c + 1 - x0) * step_x) if dx > 0.0 else (-1, (x0 - c) * step_x)
    to_r, next_y = (1, (r + 1 - y0) * step_y) if dy > 0.0 else (-1, (y0 - r) * step_y)
    total, now = 0.0, 0.0
    while True:
        last = cols + rows == 0
        across = rows == 0 or (cols > 0 and next_x <= next_y)
        then = next_x if across else next_y
        if last:
            then = 1.0
        base = sums[r, c]
        depth = y0 - r + 0.5 * (now + then) * dy
        total += (then - now) * (base + depth * (sums[r + 1, c] - base))
        if last:
            return dx * total
        now = then
        if across:
            next_x += step_x
            c += to_c
            cols -= 1
        else:
            next_y += step_y
            r += to_r
            rows -= 1


@njit(cache=True, nogil=True, error_model="numpy")
def integrals(sums, x, y):
    """Return the integrals (rows, cols) of an image over the quadrilaterals between nodes, exactly.

    The integral over a quadrilateral is the one along its four sides (Green), and neighbours share
    their sides. ``sums`` (height + 1, width) are those of the pixels above each row; pixel (r, c)
    reaches from x = c to c + 1 and from y = r to r + 1. ``x`` and ``y`` (rows + 1, cols + 1) are
    the nodes, all inside the image.
    """
    rows, cols = x.shape[0] - 1, x.shape[1] - 1
    out = np.zeros((rows, cols))
    for i in range(rows + 1):
        for k in range(cols + 1):
            x0, y0 = x[i, k], y[i, k]
            if k < cols:
                along = _under(sums, x0, y0, x[i, k + 1], y[i, k + 1])
                if i < rows:
                    out[i, k] += along
                if i > 0:
                    out[i - 1, k] -= along
            if i < rows:
                side = _under(sums, x0, y0, x[i + 1, k], y[i + 1, k])
                if k < cols:
                    out[i, k] -= side
                if k > 0:
                    out[i, k - 1] += side
    return out
