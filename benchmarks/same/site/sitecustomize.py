"""Give both sides of a comparison one version, which stands in their files, in every process that
they start."""

import planish

planish.__version__ = "9.9.9"
