"""The physical model: scene, section, track, contact law, and the equations of motion."""

from .kinematics import MOTION_SCALES as MOTION_SCALES
from .kinematics import Contacts as Contacts
from .kinematics import RailFrame as RailFrame
from .kinematics import contact_points as contact_points
from .kinematics import contacts as contacts
from .kinematics import euler_angles as euler_angles
from .kinematics import quaternion_from_euler as quaternion_from_euler
from .kinematics import rail_frame as rail_frame
from .kinematics import scaled_size as scaled_size
from .layout import StateLayout as StateLayout
from .paths import parameter as parameter
from .quantities import ACCELERATIONS as ACCELERATIONS
from .quantities import COORDINATE_SCALES as COORDINATE_SCALES
from .quantities import COORDINATES as COORDINATES
from .quantities import LOADS as LOADS
from .quantities import SECTIONS as SECTIONS
from .quantities import STARTS as STARTS
from .quantities import Parameter as Parameter
from .quantities import Quantity as Quantity
from .quantities import quantity as quantity
from .scene import scene_to_toml as scene_to_toml
from .scene_files import scene_from_json as scene_from_json
from .scene_files import scene_from_toml as scene_from_toml
from .scene_files import scene_to_json as scene_to_json
from .step_size import impacts_per_period as impacts_per_period
