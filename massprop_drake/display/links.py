"""Bodies of a multibody model as its file draws them, and their places by its joints."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba, SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from massprop_drake.errors import collect_drake_warnings
from massprop_drake.inputs.model_file import model_joints, model_kind
from massprop_drake.inputs.true_blocks import MultibodyBlock

Array = NDArray[np.float64]

_PLAIN = Rgba(0.79, 0.81, 0.84, 1.0)


class Links:
    """Links of a multibody model, drawn in the vehicle frame.

    Attributes:
        drawn: whether the model has visuals.
        count: number of links.

    Args:
        block: of the plant, with the model and the link whose frame is the vehicle frame.
    """

    def __init__(self, block: MultibodyBlock):
        self._graph = SceneGraph()
        self._plant = MultibodyPlant(0.0)
        self._plant.RegisterAsSourceForSceneGraph(self._graph)
        with collect_drake_warnings():  # of what is not drawn
            Parser(self._plant).AddModelsFromString(block.model, model_kind(block.model))
            self._plant.Finalize()
        self._context = self._plant.CreateDefaultContext()
        self._links = [self._plant.get_body(BodyIndex(number)) for number in range(1, self._plant.num_bodies())]
        self._carrier = next(link for link in self._links if link.name() == block.body)
        self._places = [
            self._plant.GetJointByName(joint.name).position_start() + number
            for joint in model_joints(block.model)
            for number in range(joint.positions)
        ]
        self.count = len(self._links)
        self.drawn = any(self._plant.GetVisualGeometriesForBody(link) for link in self._links)

    def draw(self, meshcat: Meshcat, path: str) -> None:
        """Draws the bodies' visual geometries below a Meshcat path, `<path>/<number>` each."""
        inspector = self._graph.model_inspector()
        with collect_drake_warnings():
            for number, link in enumerate(self._links):
                for place, geometry in enumerate(self._plant.GetVisualGeometriesForBody(link)):
                    below = f"{path}/{number}/{place}"
                    meshcat.SetObject(below, inspector.GetShape(geometry), _color(inspector, geometry))
                    meshcat.SetTransform(below, inspector.GetPoseInFrame(geometry))

    def poses(self, joint_positions: Array) -> Array:
        """Returns positions and quaternions of the bodies in the vehicle frame, for some joint positions.

        Args:
            joint_positions: of all joints, in the order of the signal of that name, shape (n_joints,); empty: unknown,
                so that they stand as the model has them.

        Returns:
            Position, ft or m, and quaternion of each body, one after the other, shape (7 count,).
        """
        positions = self._plant.GetPositions(self._context)
        if joint_positions.size:
            positions[self._places] = joint_positions
        self._plant.SetPositions(self._context, positions)
        poses = [
            self._plant.CalcRelativeTransform(self._context, self._carrier.body_frame(), link.body_frame())
            for link in self._links
        ]
        return np.concatenate([[*pose.translation(), *pose.rotation().ToQuaternion().wxyz()] for pose in poses])


def _color(inspector: Any, geometry: Any) -> Rgba:
    """Returns the color of a geometry in Drake's scene graph; gray where its file gives none."""
    properties = inspector.GetIllustrationProperties(geometry)
    return _PLAIN if properties is None else properties.GetPropertyOrDefault("phong", "diffuse", _PLAIN)
