# pyright: standard
"""Compiled inner loops of a sheet of fibres: ribbons laid on each other, the press that takes voids, loose fibres."""

from math import cos, floor, sin

import numpy as np

from planish.core.jit import njit

FULL = 100  # of a cell of wall and nothing else, in the whole numbers that a structure is stored in


@njit(cache=True, nogil=True)
def _trace(x, y, angle, length, half, curl, stamp, number, nodes, top, profile):
    """Nodes under a ribbon as (row, col, step, place across), and the highest node of ``top`` under each step."""
    count, steps = 0, max(int(length), 1)
    across = int(half / 0.7) + 1
    for t in range(steps):
        profile[t] = -1e9
        for k in range(-across, across + 1):
            off = half * k / across
            i, j = int(floor(y + off * cos(angle) + 0.5)), int(floor(x - off * sin(angle) + 0.5))
            if i < 0 or j < 0 or i >= top.shape[0] or j >= top.shape[1] or count >= nodes.shape[0]:
                continue
            profile[t] = max(profile[t], top[i, j])
            if stamp[i, j] != number:
                stamp[i, j] = number
                nodes[count, 0], nodes[count, 1], nodes[count, 2] = i, j, t
                nodes[count, 3] = 1000 * abs(k) // across
                count += 1
        x += cos(angle)
        y += sin(angle)
        angle += curl
    return count, steps


@njit(cache=True, nogil=True)
def _fill(column, low, high, cell):
    """Add wall between two heights over the first cell's lower border to a column of shares."""
    first, last = max(int(floor(low / cell)), 0), min(int(floor(high / cell)), column.size - 1)
    for k in range(first, last + 1):
        part = min(high, (k + 1) * cell) - max(low, k * cell)
        if part > 0:
            column[k] = min(column[k] + int(FULL * part / cell + 0.5), FULL)


@njit(cache=True, nogil=True)
def lay_ribbons(shares, top, ground, starts, angles, lengths, widths, curls, walls, lumens, flexibility, cell, enough):
    """Lay ribbons (n) on the heights ``top`` (rows, cols), in um, which rise by them; one after the other.

    ``starts`` (n, tries, 2): of the places (x, y) of a ribbon's beginning, that over the lowest ground is taken.
    Lengths, widths, curls in nodes; walls and lumens in um. ``shares`` (rows, cols, n) uint8 takes the share of wall of
    cells of ``cell`` um over ``ground`` (rows, cols). A ribbon lies on the highest node under each piece of it and
    falls between them by ``flexibility`` um a node at most. The last one is that with which the walls of all nodes
    together are ``enough`` um high.
    """
    rows, cols = top.shape
    stamp = np.zeros((rows, cols), np.int32)
    longest = int(lengths.max()) + 2
    profile = np.empty(longest)
    nodes = np.empty((longest * (int(widths.max()) + 3) * 2, 4), np.int32)
    total_wall = 0.0
    for n in range(starts.shape[0]):
        if total_wall >= enough:
            return
        best, least = 0, 1e9
        for c in range(starts.shape[1]):
            total, seen = 0.0, 0
            for q in range(12):
                along = lengths[n] * q / 11
                turn = angles[n] + 0.5 * curls[n] * along
                i = int(starts[n, c, 1] + along * sin(turn))
                j = int(starts[n, c, 0] + along * cos(turn))
                if 0 <= i < rows and 0 <= j < cols:
                    total += top[i, j]
                    seen += 1
            if seen and total / seen < least:
                best, least = c, total / seen
        count, steps = _trace(
            starts[n, best, 0], starts[n, best, 1], angles[n], lengths[n], 0.5 * widths[n], curls[n], stamp, n + 1,
            nodes, top, profile,
        )  # fmt: skip
        for t in range(1, steps):
            profile[t] = max(profile[t], profile[t - 1] - flexibility[n])
        for t in range(steps - 2, -1, -1):
            profile[t] = max(profile[t], profile[t + 1] - flexibility[n])
        for q in range(count):
            i, j = nodes[q, 0], nodes[q, 1]
            rounding = 1.0 - (nodes[q, 3] / 1000.0) ** 4 * 0.7  # edges are thinner than the middle
            low = profile[nodes[q, 2]]
            wall, lumen = walls[n] * rounding, lumens[n] * rounding
            high = low + 2 * wall + lumen
            total_wall += 2 * wall
            over = low - ground[i, j]
            if lumen > 0.0:
                _fill(shares[i, j], over, over + wall, cell)
                _fill(shares[i, j], over + wall + lumen, high - ground[i, j], cell)
            else:
                _fill(shares[i, j], over, high - ground[i, j], cell)
            top[i, j] = max(top[i, j], high)


@njit(cache=True, nogil=True)
def press(out, low, sign, shares, heights, ground, pressed, cell, void_floor):
    """Press columns of ``shares`` over ``ground`` from ``heights`` to ``pressed``, voids first; add them to ``out``.

    ``out`` (rows, cols, n) uint8 begins at ``low`` um; ``sign`` turns heights of the lower half over. Of a void at
    least the share ``void_floor`` stays as long as wall can give way instead; its mass is lost.
    """
    rows, cols, count = shares.shape
    line = np.zeros(out.shape[2])
    for i in range(rows):
        for j in range(cols):
            base = ground[i, j]
            height, target = heights[i, j] - base, max(pressed[i, j] - base, 0.5)
            solid = 0.0
            for k in range(count):
                solid += shares[i, j, k] * cell / FULL
            void = max(height - solid, 1e-6)
            open_ = (target - solid) / void
            wall = 1.0
            if open_ < void_floor:
                open_ = min(void_floor, target / (2 * void))
                wall = (target - open_ * void) / max(solid, 1e-6)
            line[:] = 0.0
            z = 0.0
            for k in range(min(int(height / cell) + 1, count)):
                size = min(cell, height - k * cell)
                if size <= 0:
                    break
                share = min(shares[i, j, k] * cell / FULL, size)
                thick = share * wall + (size - share) * open_
                if thick <= 1e-9:
                    continue
                density = min(share * wall / thick, 1.0)
                a, b = base + z, base + z + thick
                if sign < 0:
                    a, b = -b, -a
                z += thick
                if density <= 0.0:
                    continue
                first, last = int(floor((a - low) / cell)), int(floor((b - low) / cell))
                for m in range(max(first, 0), min(last, line.size - 1) + 1):
                    part = min(b, low + (m + 1) * cell) - max(a, low + m * cell)
                    line[m] += density * max(part, 0.0) / cell
            for m in range(line.size):
                if line[m] > 0:
                    out[i, j, m] = min(out[i, j, m] + int(FULL * line[m] + 0.5), FULL)


@njit(cache=True, nogil=True)
def raise_fibres(out, low, sign, face, starts, angles, lengths, widths, curls, thickness, rises, cell):
    """Add fibres (n) that leave a face at their beginning and stand off it by ``rises`` um at their free end."""
    stamp = np.zeros(face.shape, np.int32)
    longest = int(lengths.max()) + 2
    profile = np.empty(longest)
    nodes = np.empty((longest * (int(widths.max()) + 3) * 2, 4), np.int32)
    for n in range(starts.shape[0]):
        count, steps = _trace(
            starts[n, 0], starts[n, 1], angles[n], lengths[n], 0.5 * widths[n], curls[n], stamp, n + 1, nodes, face,
            profile,
        )  # fmt: skip
        start = profile[0]
        for q in range(count):
            i, j = nodes[q, 0], nodes[q, 1]
            share = nodes[q, 2] / max(steps - 1, 1)
            a = max(start, -1e8) + rises[n] * share * share - thickness[n]
            b = a + thickness[n]
            if sign < 0:
                a, b = -b, -a
            _fill(out[i, j], a - low, b - low, cell)
