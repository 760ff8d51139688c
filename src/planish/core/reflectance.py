"""Light in a scattering layer (Kubelka and Munk).

The formula that makes images of known specimens and reads images.

P. Kubelka and F. Munk, Z. Tech. Phys. 12, 593 (1931); the exact form for a layer over a backing is
equation 9 of P. Kubelka, J. Opt. Soc. Am. 38, 448 (1948).
"""

import numpy as np
from numpy.typing import ArrayLike

from planish.core.typing import Floats

LUMINANCE = (0.2126, 0.7152, 0.0722)  # weights of red, green and blue, Rec. ITU-R BT.709


def layer_over(
    backing: ArrayLike, scattering: ArrayLike, absorption: ArrayLike, weight: ArrayLike
) -> Floats:
    """Reflectance of a layer over a backing; all arguments broadcast.

    ``R = [1 - Rg (a - b coth(b s W))] / [a - Rg + b coth(b s W)]`` with ``a = (s + k) / s`` and
    ``b^2 = a^2 - 1``, multiplied by ``tanh(b s W) / b``: nothing is divided by ``s``, ``k`` or
    ``W``, which may be 0, nor overflows in thick layers. Neither coefficient, s and k, is negative;
    the weight is finite, in units of one over theirs.
    """
    below, s, k, w = (np.asarray(a, np.float64) for a in (backing, scattering, absorption, weight))
    rate = np.sqrt(k * (k + 2 * s))  # b s
    depth = rate * w
    thin = depth < 1e-8  # there tanh(x) / x is 1 to the last digit
    depth = np.where(thin, 1.0, depth)
    rate = np.where(thin, 1.0, rate)
    reach = np.where(thin, w, np.tanh(depth) / rate)  # tanh(b s W) / (b s): W of a thin layer
    loss = (s + k) * reach
    return (below + s * reach - below * loss) / (1 + loss - below * s * reach)
