# pyright: standard
"""Compiled inner loops of a sheet of fibres.

Ribbons laid on each other, the press that takes voids, and loose fibres.
"""

from math import cos, floor, sin

import numpy as np

from planish.core.jit import njit

FULL = 100  # of a cell of wall and nothing else, in the whole numbers that a structure is stored in


@njit(cache=True, nogil=True)
def _scratch(shape, lengths, widths):
    """Arrays that :func:`_trace` works in: stamps of nodes, heights by steps, and nodes."""
    longest = int(lengths.max()) + 2
    most_nodes = longest * (int(widths.max()) + 3) * 2
    stamp = np.zeros(shape, np.int32)
    nodes = np.empty((most_nodes, 4), np.int32)
    return stamp, np.empty(longest), nodes


@njit(cache=True, nogil=True)
def _trace(start, angle, length, half_width, curl, stamp, fibre_number, nodes, top, step_height):
    """Find the nodes under a ribbon, and the highest node of ``top`` under each step along it.

    ``nodes`` gets (row, col, step, place across), the place in thousandths from the middle to the
    edge, ``step_height`` the heights; how many of both is returned. The ribbon begins at ``start``
    (x, y) and turns by ``curl`` a step, all in nodes. ``stamp`` keeps the number of the last fibre
    at each node, so that a node is listed once. Across a ribbon samples lie 0.7 nodes apart or
    closer, which leaves none out.
    """
    x, y = start
    rows, cols = top.shape
    n_nodes = 0
    n_steps = max(int(length), 1)
    n_across = int(half_width / 0.7) + 1
    for t in range(n_steps):
        step_height[t] = -1e9
        for k in range(-n_across, n_across + 1):
            offset = half_width * k / n_across
            i = int(floor(y + offset * cos(angle) + 0.5))
            j = int(floor(x - offset * sin(angle) + 0.5))
            if not (0 <= i < rows and 0 <= j < cols and n_nodes < len(nodes)):
                continue
            step_height[t] = max(step_height[t], top[i, j])
            if stamp[i, j] != fibre_number:
                stamp[i, j] = fibre_number
                nodes[n_nodes] = i, j, t, 1000 * abs(k) // n_across
                n_nodes += 1
        x += cos(angle)
        y += sin(angle)
        angle += curl
    return n_nodes, n_steps


@njit(cache=True, nogil=True)
def _fill(column, bottom, top, cell):
    """Add wall between two heights over the first cell of a column, in um, to its cells."""
    first = max(int(floor(bottom / cell)), 0)
    last = min(int(floor(top / cell)), column.size - 1)
    for k in range(first, last + 1):
        overlap = min(top, (k + 1) * cell) - max(bottom, k * cell)
        if overlap > 0:
            column[k] = min(column[k] + int(FULL * overlap / cell + 0.5), FULL)


@njit(cache=True, nogil=True)
def lay_ribbons(  # noqa: C901
    shares,
    top,
    ground,
    starts,
    angles,
    lengths,
    widths,
    curls,
    walls,
    lumens,
    flexibility,
    cell,
    wall_um,
):
    """Lay ribbons (n) on the heights ``top`` (rows, cols), in um, which rise by them.

    One after the other.

    ``starts`` (n, tries, 2): of the places (x, y) of a ribbon's beginning, that over the lowest
    ground is taken. Lengths, widths, curls in nodes; walls and lumens in um. ``shares`` (rows,
    cols, n) uint8 takes the share of wall of cells of ``cell`` um over ``ground`` (rows, cols). A
    ribbon lies on the highest node under each piece of it and falls between them by ``flexibility``
    um a node at most. The last one is that with which the walls of all nodes together are
    ``wall_um`` um high.
    """
    rows, cols = top.shape
    stamp, step_height, nodes = _scratch(top.shape, lengths, widths)
    total_wall = 0.0
    for n in range(starts.shape[0]):
        if total_wall >= wall_um:
            return
        best = 0
        lowest_mean = 1e9
        for c in range(starts.shape[1]):
            height_sum = 0.0
            n_samples = 0
            for q in range(12):
                distance = lengths[n] * q / 11
                direction = angles[n] + 0.5 * curls[n] * distance
                i = int(starts[n, c, 1] + distance * sin(direction))
                j = int(starts[n, c, 0] + distance * cos(direction))
                if 0 <= i < rows and 0 <= j < cols:
                    height_sum += top[i, j]
                    n_samples += 1
            if n_samples and height_sum / n_samples < lowest_mean:
                best = c
                lowest_mean = height_sum / n_samples
        ribbon = starts[n, best], angles[n], lengths[n], 0.5 * widths[n], curls[n]
        n_nodes, n_steps = _trace(*ribbon, stamp, n + 1, nodes, top, step_height)
        for t in range(1, n_steps):
            step_height[t] = max(step_height[t], step_height[t - 1] - flexibility[n])
        for t in range(n_steps - 2, -1, -1):
            step_height[t] = max(step_height[t], step_height[t + 1] - flexibility[n])
        for q in range(n_nodes):
            i = nodes[q, 0]
            j = nodes[q, 1]
            rounding = 1.0 - (nodes[q, 3] / 1000.0) ** 4 * 0.7  # edges are thinner than the middle
            low = step_height[nodes[q, 2]]
            wall = walls[n] * rounding
            lumen = lumens[n] * rounding
            high = low + 2 * wall + lumen
            total_wall += 2 * wall
            cells = shares[i, j]
            height_above = low - ground[i, j]
            if lumen > 0.0:
                _fill(cells, height_above, height_above + wall, cell)
                _fill(cells, height_above + wall + lumen, high - ground[i, j], cell)
            else:
                _fill(cells, height_above, high - ground[i, j], cell)
            top[i, j] = max(top[i, j], high)


@njit(cache=True, nogil=True)
def press(out, low, sign, shares, heights, ground, pressed, cell, void_floor):  # noqa: C901
    """Press columns of ``shares`` over ``ground`` from ``heights`` to ``pressed``, voids first.

    Add them to ``out``.

    ``out`` (rows, cols, n) uint8 begins at ``low`` um; ``sign`` turns heights of the lower half
    over. Of a void at least the share ``void_floor`` stays as long as wall can give way instead;
    its mass is lost.
    """
    rows, cols, n_cells = shares.shape
    pressed_shares = np.zeros(out.shape[2])
    for i in range(rows):
        for j in range(cols):
            base = ground[i, j]
            height = heights[i, j] - base
            target = max(pressed[i, j] - base, 0.5)
            solid = 0.0
            for k in range(n_cells):
                solid += shares[i, j, k] * cell / FULL
            void = max(height - solid, 1e-6)
            open_share = (target - solid) / void
            wall_share = 1.0
            if open_share < void_floor:
                open_share = min(void_floor, target / (2 * void))
                wall_share = (target - open_share * void) / max(solid, 1e-6)
            pressed_shares[:] = 0.0
            z = 0.0
            for k in range(min(int(height / cell) + 1, n_cells)):
                cell_part = min(cell, height - k * cell)
                if cell_part <= 0:
                    break
                share = min(shares[i, j, k] * cell / FULL, cell_part)
                thickness = share * wall_share + (cell_part - share) * open_share
                if thickness <= 1e-9:
                    continue
                density = min(share * wall_share / thickness, 1.0)
                a = base + z
                b = base + z + thickness
                if sign < 0:
                    a, b = -b, -a
                z += thickness
                if density <= 0.0:
                    continue
                first = int(floor((a - low) / cell))
                last = int(floor((b - low) / cell))
                for m in range(max(first, 0), min(last, pressed_shares.size - 1) + 1):
                    overlap = min(b, low + (m + 1) * cell) - max(a, low + m * cell)
                    pressed_shares[m] += density * max(overlap, 0.0) / cell
            for m in range(pressed_shares.size):
                pressed_share = pressed_shares[m]
                if pressed_share > 0:
                    out[i, j, m] = min(out[i, j, m] + int(FULL * pressed_share + 0.5), FULL)


@njit(cache=True, nogil=True)
def raise_fibres(
    out, low, sign, face, starts, angles, lengths, widths, curls, thickness, rises, cell
):
    """Add fibres (n) that begin at a face and stand off it by ``rises`` um at their free end.

    ``out`` (rows, cols, cells) uint8 begins at ``low`` um, ``face`` (rows, cols) is outwards, and
    ``sign`` is -1 for the lower one. Places, lengths, widths and curls are in nodes, ``thickness``
    in um. A fibre rises with the square of the way along it, from the height of the face where it
    begins.
    """
    stamp, step_height, nodes = _scratch(face.shape, lengths, widths)
    for n in range(starts.shape[0]):
        ribbon = starts[n], angles[n], lengths[n], 0.5 * widths[n], curls[n]
        n_nodes, n_steps = _trace(*ribbon, stamp, n + 1, nodes, face, step_height)
        root_height = max(step_height[0], -1e8)
        for q in range(n_nodes):
            i = nodes[q, 0]
            j = nodes[q, 1]
            length_share = nodes[q, 2] / max(n_steps - 1, 1)
            a = root_height + rises[n] * length_share * length_share - thickness[n]
            b = a + thickness[n]
            if sign < 0:
                a, b = -b, -a
            _fill(out[i, j], a - low, b - low, cell)
