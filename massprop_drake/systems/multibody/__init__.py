"""Jets and sensors of a vehicle file beside any continuous MultibodyPlant.

`BodyMotion` makes of the plant's ports the `body_state` that the sensors of `systems.vehicle` read, so these are the
same sensors, with the same errors. `diagrams.multibody.add_thrusters_and_sensors` adds and connects them all.
"""

from massprop_drake.systems.multibody.body_motion import BodyMotion
from massprop_drake.systems.multibody.body_wrench import BodyWrench
from massprop_drake.systems.multibody.joint_drive import JointDrive
from massprop_drake.systems.multibody.multibody_vehicle import BodyBridge, MultibodyVehicle
from massprop_drake.systems.multibody.star_tracker import StarTracker
from massprop_drake.systems.multibody.thrusters import Thrusters
from massprop_drake.systems.vehicle.integrating_accelerometer import IntegratingAccelerometer
from massprop_drake.systems.vehicle.rate_gyro import RateGyro

__all__ = [
    "BodyBridge",
    "BodyMotion",
    "BodyWrench",
    "IntegratingAccelerometer",
    "JointDrive",
    "MultibodyVehicle",
    "RateGyro",
    "StarTracker",
    "Thrusters",
]
