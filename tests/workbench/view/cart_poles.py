"""A cart on a rail whose pole ends in a plate in the wind, as a reader would build it."""

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench import SectionLayout, WindModel, add_tail_force, add_wind, observe

URDF = """
<robot name="cart_pole">
  <link name="cart">
    <inertial>
      <mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual><geometry><box size="0.3 0.2 0.1"/></geometry></visual>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="world"/><child link="cart"/><axis xyz="1 0 0"/>
  </joint>
  <link name="pole">
    <inertial>
      <origin xyz="0 0 -0.5"/><mass value="0.2"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.0001" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual>
      <origin xyz="0 0 -0.5"/><geometry><capsule radius="0.02" length="0.96"/></geometry>
    </visual>
  </link>
  <joint name="swing" type="continuous">
    <parent link="cart"/><child link="pole"/><axis xyz="0 1 0"/>
  </joint>
</robot>
"""
PLATE = SectionLayout.strip(
    start=0.4, length=0.6, width=0.2, axis_B=(0.0, 0.0, -1.0), normal_B=(1.0, 0.0, 0.0)
)


def add_cart_pole(builder, time_step):
    """The cart-pole in a builder, with the force on its plate, in wind along x."""
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step)
    Parser(plant).AddModelsFromString(URDF, "urdf")
    plant.Finalize()
    wind = add_wind(builder, WindModel(mean=(2.0, 0.0, 0.0)))
    add_tail_force(builder, plant, "pole", PLATE, 1.2, wind=wind)
    return plant


def observed_swing(time_step, path=None, **options):
    """Half a second of a swing from 1 rad: its log, the plant, and the plant's context at the
    end.
    """
    builder = DiagramBuilder()
    plant = add_cart_pole(builder, time_step)
    with observe(builder, plant, log=path, base="pole", name="my cart", **options) as run:
        diagram = builder.Build()
        simulator = Simulator(diagram)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.GetJointByName("swing").set_angle(context, 1.0)
        simulator.AdvanceTo(0.5)
    plant.diagram = diagram  # which owns it
    return run.log, plant, context
