"""Pose of the camera: from material coordinates of the sheet to the image, and exactly back."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from planish.core.transform import Similarity, grid_points
from planish.core.typing import Floats, Pair, Shape2D, pair_of
from planish.synthetic.params import CameraParams

_TALL, _WIDE = 1.30, 1.12  # of the frame, over the height and width of what the volume shows
_UPRIGHT_DEG = 15.0  # up to this turn the frame keeps those sides; beyond, it follows the field
# Share of the field in the frame: without and with the shift.
_CENTRED_IN_VIEW, _LEAST_IN_VIEW = 0.98, 0.975
_GROWTH = 1.02


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPose:
    """Map from material coordinates (u, v) to image coordinates (x, y), both in um.

    A point is stretched about the sheet's middle, carried by the similarity, and moved by the lens:
    ``p' = c + (p - c) (1 + radial r^2)`` with ``r = |p - c| / half_diagonal_um``. That is the first
    term of the usual polynomial model (Brown, Photogramm. Eng. 37, 855, 1971).
    """

    similarity: Similarity  # rotation, scale error, shift and mirror
    stretch: float = 0.0  # strain ``e``: lengths along u grow by ``1 + e``, along v by ``1 - e``
    # (u, v) of the sheet's middle, which the stretch leaves alone.
    middle_um: Pair = (0.0, 0.0)
    radial: float = 0.0  # ``k1``: relative displacement at half the frame's diagonal
    # (x, y) of the frame's middle, which the lens leaves alone.
    centre_um: Pair = (0.0, 0.0)
    half_diagonal_um: float = 1.0  # unit of the radius

    def __call__(self, points: ArrayLike) -> Floats:
        """Carry material points (..., 2), (u, v) in um, to the image: (x, y) in um.

        NaN stays NaN.
        """
        middle = np.array(self.middle_um)
        centre = np.array(self.centre_um)
        from_middle = np.asarray(points, dtype=np.float64) - middle
        stretched = middle + from_middle * self._strain()
        offset = self.similarity(stretched) - centre
        squares = np.sum(offset * offset, axis=-1, keepdims=True)
        radius_squared = squares / self.half_diagonal_um**2
        return centre + offset * (1 + self.radial * radius_squared)

    def inverse(self, points: ArrayLike) -> Floats:
        """Carry image points (..., 2), (x, y) in um, to (u, v) in um, to 1e-9 um.

        NaN where the lens shows none.
        """
        middle = np.array(self.middle_um)
        centre = np.array(self.centre_um)
        offset = np.asarray(points, dtype=np.float64) - centre
        if self.radial != 0:
            radius_um = np.hypot(offset[..., 0], offset[..., 1])
            radius = radius_um / self.half_diagonal_um
            offset = offset * self._shrink(radius)[..., None]
        stretched = self.similarity.inverse(offset + centre)
        return middle + (stretched - middle) / self._strain()

    def _strain(self) -> Floats:
        return np.array([1 + self.stretch, 1 - self.stretch])

    def _shrink(self, shown: Floats) -> Floats:
        """Return the radius on the sheet over the radius in the image, ``shown``.

        It is found by Newton's method on ``t + k t^3 = shown``.

        The cubic bends to one side only, and ``t = shown`` lies on the side from which Newton's
        steps never overshoot.
        """
        k = self.radial
        fold = np.inf
        if k < 0:
            fold = 2 / (3 * np.sqrt(-3 * k))  # the cubic's maximum
        t = np.where(shown > fold, np.nan, shown)
        # Never reached: from its start the iteration is monotonic and ends within ten.
        for _ in range(50):
            step = (t + k * t**3 - shown) / (1 + 3 * k * t * t)
            t -= step
            rounding = 1e-14 * (1 + np.abs(t))
            if not np.any(np.abs(step) > rounding):
                break
        return np.divide(t, shown, out=np.ones_like(t), where=shown > 0)


def draw_pose(
    camera: CameraParams, spread: ArrayLike, rng: np.random.Generator
) -> tuple[Shape2D, CameraPose]:
    """Frame the camera so that it sees about what the volume holds.

    It is turned, stands beside it, and has errors of its own.

    Parameters
    ----------
    camera : CameraParams
    spread : (u0, v0, u1, v1), in um
        Material that the volume shows. At least 85 % of it lies in the frame: the drawn shift is
        shortened as far as that needs.
    rng : Generator
        Every number is drawn whatever its size, in a fixed order: one that is switched off does
        not move the others.

    Returns
    -------
    shape : (rows, cols) of the image
    pose : CameraPose
    """
    turn, shift_x, shift_y, scale, stretch = rng.uniform(-1.0, 1.0, 5)
    field = np.asarray(spread, dtype=np.float64)
    rotation = float(np.deg2rad(camera.turn_deg + camera.turn_range_deg * turn))
    middle = 0.5 * (field[:2] + field[2:])
    width_um, height_um = _frame_sides(field, rotation)
    scale_factor = float(1 + camera.scale_range * scale)
    linear = Similarity(scale=scale_factor, rotation_rad=rotation, mirrored=camera.mirrored)
    axes = np.linspace(field[:2], field[2:], 101)
    grid = grid_points(*axes.T)

    def posed(shape: Shape2D, shift: Floats) -> CameraPose:
        """The pose that brings the sheet's middle ``shift`` (x, y) away from the frame's, in um."""
        last_pixel = np.array(shape[::-1]) - 1.0
        centre = 0.5 * camera.pixel_um * last_pixel
        shift_um = pair_of(centre + shift - linear(middle))
        return CameraPose(
            similarity=replace(linear, shift_um=shift_um),
            stretch=float(camera.stretch * stretch),
            middle_um=pair_of(middle),
            radial=camera.radial,
            centre_um=pair_of(centre),
            half_diagonal_um=float(np.hypot(*centre)),
        )

    def in_view(shape: Shape2D, shift: Floats) -> float:
        """Share of the material that lies in the frame."""
        pose = posed(shape, shift)
        image_points = pose(grid)
        last_um = 2 * np.array(pose.centre_um)
        is_inside = (image_points >= 0) & (image_points <= last_um)
        return float(np.mean(np.all(is_inside, axis=-1)))

    no_shift = np.zeros(2)
    rows = max(int(_TALL * height_um / camera.pixel_um), 2)
    cols = max(int(_WIDE * width_um / camera.pixel_um), 2)
    while in_view((rows, cols), no_shift) < _CENTRED_IN_VIEW:
        rows = int(_GROWTH * rows) + 1
        cols = int(_GROWTH * cols) + 1
    shape = (rows, cols)
    drawn_shift = camera.shift_range_um * np.array([shift_x, shift_y])
    low = 0.0
    high = 1.0
    if in_view(shape, drawn_shift) >= _LEAST_IN_VIEW:
        return shape, posed(shape, drawn_shift)
    # A frame that moves away from the middle of a rectangle loses field all the way, so halving
    # finds the limit.
    for _ in range(30):
        share = 0.5 * (low + high)
        if in_view(shape, share * drawn_shift) >= _LEAST_IN_VIEW:
            low = share
        else:
            high = share
    return shape, posed(shape, low * drawn_shift)


def _frame_sides(field: Floats, rotation: float) -> Pair:
    """Width and height of the field as it lies under the camera.

    They change places with a quarter turn.
    """
    width, height = field[2:] - field[:2]
    off_upright = abs(np.remainder(np.rad2deg(rotation) + 90.0, 180.0) - 90.0)
    share = (off_upright - _UPRIGHT_DEG) / (90.0 - 2 * _UPRIGHT_DEG)
    turn = np.deg2rad(np.clip(share, 0.0, 1.0) * 90.0)
    cos = np.cos(turn)
    sin = np.sin(turn)
    return float(width * cos + height * sin), float(width * sin + height * cos)
