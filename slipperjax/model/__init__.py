"""The physical model: scene, section, track, contact law, and the equations of motion."""

from .kinematics import MOTION_SCALES as MOTION_SCALES
from .kinematics import accuracy_scales as accuracy_scales
from .kinematics import contact_points as contact_points
from .kinematics import contacts as contacts
from .kinematics import euler_angles as euler_angles
from .kinematics import quaternion_from_euler as quaternion_from_euler
from .kinematics import rail_frame as rail_frame
from .kinematics import scaled_size as scaled_size
from .layout import StateLayout as StateLayout
from .parameters import parameter as parameter
from .parameters import quantity as quantity
from .quantities import ACCELERATIONS as ACCELERATIONS
from .quantities import COORDINATE_SCALES as COORDINATE_SCALES
from .quantities import COORDINATES as COORDINATES
from .quantities import SECTIONS as SECTIONS
from .quantities import Quantity as Quantity
from .random_rails import AbstractSpectrum as AbstractSpectrum
from .random_rails import CornerSpectrum as CornerSpectrum
from .random_rails import PowerLawSpectrum as PowerLawSpectrum
from .random_rails import TableSpectrum as TableSpectrum
from .scene_files import scene_from_json as scene_from_json
from .scene_files import scene_from_toml as scene_from_toml
from .scene_files import scene_to_json as scene_to_json
from .surveys import SurveyedTrack as SurveyedTrack
