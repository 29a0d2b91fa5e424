"""The physical model: scene, section, track, contact law, and the equations of motion."""

from .kinematics import (
    MOTION_SCALES as MOTION_SCALES,
    accuracy_scales as accuracy_scales,
    contact_points as contact_points,
    contacts as contacts,
    euler_angles as euler_angles,
    quaternion_from_euler as quaternion_from_euler,
    rail_frame as rail_frame,
    scaled_size as scaled_size,
)
from .layout import StateLayout as StateLayout
from .parameters import parameter as parameter, quantity as quantity
from .quantities import (
    ACCELERATIONS as ACCELERATIONS,
    COORDINATE_SCALES as COORDINATE_SCALES,
    COORDINATES as COORDINATES,
    SECTIONS as SECTIONS,
    Quantity as Quantity,
)
from .random_rails import (
    AbstractSpectrum as AbstractSpectrum,
    CornerSpectrum as CornerSpectrum,
    PowerLawSpectrum as PowerLawSpectrum,
    TableSpectrum as TableSpectrum,
)
from .scene_files import (
    scene_from_json as scene_from_json,
    scene_from_toml as scene_from_toml,
    scene_to_json as scene_to_json,
)
from .surveys import SurveyedRails as SurveyedRails, SurveyedTrack as SurveyedTrack
