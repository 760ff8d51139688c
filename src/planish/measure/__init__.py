"""From surfaces, and the volume between them, to properties along the normals of the centre surface."""

from planish.measure.along_normals import PROPERTIES, STATUS, measure_properties
from planish.measure.along_rays import measure_along_rays
from planish.measure.coat_weight import coat_weight_bottom, coat_weight_top
from planish.measure.coverage import thin_fraction
from planish.measure.densities import Densities
from planish.measure.filler import filler, filler_weight
from planish.measure.grammage import apparent_density, grammage
from planish.measure.ink import ink_depth_50, ink_depth_90, ink_depth_95
from planish.measure.options import RayOptions
from planish.measure.orientation import axial_angle, fibre_angle, fibre_anisotropy, orientation_layers
from planish.measure.pores import pore_chord, pore_diameter
from planish.measure.porosity import porosity
from planish.measure.profiles import depth_profiles
from planish.measure.ray_frame import straighten
from planish.measure.rays import Rays
from planish.measure.registry import Measured, Property, Sheet, ray_property, registered, sheet_property
from planish.measure.thickness import thickness, thickness_envelope
from planish.measure.topography import Roughness, roughness_numbers, scale_limited
from planish.measure.two_sides import coating_difference, topography_difference, two_sidedness
from planish.measure.warp import gaussian_curvature, mean_curvature, tilt, warp

__all__ = [
    "PROPERTIES",
    "STATUS",
    "Densities",
    "Measured",
    "Property",
    "RayOptions",
    "Rays",
    "Roughness",
    "Sheet",
    "apparent_density",
    "axial_angle",
    "coat_weight_bottom",
    "coat_weight_top",
    "coating_difference",
    "depth_profiles",
    "fibre_angle",
    "fibre_anisotropy",
    "filler",
    "filler_weight",
    "gaussian_curvature",
    "grammage",
    "ink_depth_50",
    "ink_depth_90",
    "ink_depth_95",
    "mean_curvature",
    "measure_along_rays",
    "measure_properties",
    "orientation_layers",
    "pore_chord",
    "pore_diameter",
    "porosity",
    "ray_property",
    "registered",
    "roughness_numbers",
    "scale_limited",
    "sheet_property",
    "straighten",
    "thickness",
    "thickness_envelope",
    "thin_fraction",
    "tilt",
    "topography_difference",
    "two_sidedness",
    "warp",
]
