"""The physical model: scene, section, track, contact law, and the equations of motion."""

from .contact import (
    AbstractContactLaw as AbstractContactLaw,
    AbstractIntegratedMemory as AbstractIntegratedMemory,
    AbstractMemory as AbstractMemory,
    ConstantDamping as ConstantDamping,
    EventLatch as EventLatch,
    Flores as Flores,
    HertzSpring as HertzSpring,
    HuntCrossley as HuntCrossley,
    LankaraniNikravesh as LankaraniNikravesh,
    PeakRateLatch as PeakRateLatch,
    SmoothSwitch as SmoothSwitch,
)
from .dang2024 import paper_section as paper_section
from .dynamics import Args as Args, Reactions as Reactions, reactions as reactions, vector_field as vector_field
from .faults import Fault as Fault, FaultyTrack as FaultyTrack
from .kinematics import (
    MOTION_SCALES as MOTION_SCALES,
    ModalMotion as ModalMotion,
    PayloadMotion as PayloadMotion,
    accuracy_scales as accuracy_scales,
    contact_points as contact_points,
    contacts as contacts,
    euler_angles as euler_angles,
    quaternion_from_euler as quaternion_from_euler,
    rail_frame as rail_frame,
    scaled_size as scaled_size,
)
from .layout import StateLayout as StateLayout
from .loads import (
    AbstractFriction as AbstractFriction,
    AbstractLoad as AbstractLoad,
    AerodynamicLoad as AerodynamicLoad,
    AppliedLoad as AppliedLoad,
    Coulomb as Coulomb,
    FadingFriction as FadingFriction,
    SumLoad as SumLoad,
    TabulatedLoad as TabulatedLoad,
)
from .modes import Modes as Modes, load_modes as load_modes
from .parameters import parameter as parameter, quantity as quantity
from .payload import Payload as Payload
from .quantities import (
    ACCELERATIONS as ACCELERATIONS,
    COORDINATE_SCALES as COORDINATE_SCALES,
    COORDINATES as COORDINATES,
    SECTIONS as SECTIONS,
    Quantity as Quantity,
)
from .rails import SampledTrack as SampledTrack, TrackSet as TrackSet
from .random_rails import (
    AbstractSpectrum as AbstractSpectrum,
    CornerSpectrum as CornerSpectrum,
    PowerLawSpectrum as PowerLawSpectrum,
    RandomRails as RandomRails,
    TableSpectrum as TableSpectrum,
)
from .scene_files import (
    SceneFile as SceneFile,
    scene_from_json as scene_from_json,
    scene_from_toml as scene_from_toml,
    scene_to_json as scene_to_json,
)
from .sensors import Sensor as Sensor
from .sled import Cut as Cut
from .step_size import contact_duration as contact_duration, default_steps_per_period as default_steps_per_period
from .surveys import SurveyedRails as SurveyedRails, SurveyedTrack as SurveyedTrack, load_speed as load_speed
from .thrust import RocketSled as RocketSled, WaterBrake as WaterBrake
from .tracks import (
    AbstractTrack as AbstractTrack,
    FourierTrack as FourierTrack,
    Irregularity as Irregularity,
    LocalTrack as LocalTrack,
    StraightTrack as StraightTrack,
    SumTrack as SumTrack,
    TwoRails as TwoRails,
)
from .wear import AbstractWear as AbstractWear, Wear as Wear, WearTable as WearTable
