# Exudyn on the rods' tasks: geometrically exact beams of two nodes, static solver. Its beams lie along x: the task's
# (z, x, y) are its (x, y, z). A spontaneous twist is the nodes' reference rotation, a spontaneous extension the reference
# length (all stiffnesses are per that length). Nodes of Euler angles: with those of the Lie group the solver does not converge.
exudyn = package("exudyn")
import numpy
from exudyn.itemInterface import *

LENGTH = TASK["length"]
EA, EI, GJ, GA = TASK["stiffness"]


def turned(v):
    return [v[2], v[0], v[1]]


def rod(system, place, extension, twist, elements):
    """Nodes of the base and of the tip."""
    section = exudyn.BeamSection()
    section.stiffnessMatrix = (1.0 + extension) * numpy.diag([EA, GA, GA, GJ, EI, EI])
    section.inertia, section.massPerLength = numpy.eye(3), 1.0
    nodes = []
    for i in range(elements + 1):
        s = LENGTH * i / elements
        reference = [s * (1.0 + extension), place[0], place[1], twist * s, 0.0, 0.0]
        begin = [-s * extension, 0.0, 0.0, -twist * s, 0.0, 0.0]
        nodes.append(system.AddNode(NodeRigidBodyRxyz(referenceCoordinates=reference, initialCoordinates=begin)))
    length = LENGTH * (1.0 + extension) / elements
    for pair in zip(nodes, nodes[1:]):
        system.AddObject(ObjectBeamGeometricallyExact(nodeNumbers=list(pair), length=length, sectionData=section))
    return nodes[0], nodes[-1]


def fixed(system, body, place, node):
    markers = [
        system.AddMarker(MarkerBodyRigid(bodyNumber=body, localPosition=[0.0, *place])),
        system.AddMarker(MarkerNodeRigid(nodeNumber=node)),
    ]
    system.AddObject(GenericJoint(markerNumbers=markers, constrainedAxes=[1] * 6))


def prepared(case, elements, steps):
    system = exudyn.SystemContainer().AddSystem()
    ground = system.AddObject(ObjectGround())
    rods = case["rods"]
    if len(rods) == 1:
        base, end = rod(system, [0.0, 0.0], *rods[0][2:], elements)
        fixed(system, ground, [0.0, 0.0], base)
    else:
        end = system.AddNode(NodeRigidBodyRxyz(referenceCoordinates=[LENGTH, 0.0, 0.0, 0.0, 0.0, 0.0]))
        plate = ObjectRigidBody(physicsMass=1.0, physicsInertia=[1.0, 1.0, 1.0, 0.0, 0.0, 0.0], nodeNumber=end)
        plate = system.AddObject(plate)
        for x, y, extension, twist in rods:
            base, tip = rod(system, [x, y], extension, twist, elements)
            fixed(system, ground, [x, y], base)
            fixed(system, plate, [x, y], tip)
    marker = system.AddMarker(MarkerNodeRigid(nodeNumber=end))
    system.AddLoad(Force(markerNumber=marker, loadVector=turned(case["force"])))
    system.AddLoad(Torque(markerNumber=marker, loadVector=turned(case["moment"])))
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.staticSolver.numberOfLoadSteps = steps
    settings.staticSolver.adaptiveStep = False
    settings.staticSolver.verboseMode = 0
    settings.solutionSettings.writeSolutionToFile = False
    settings.linearSolverType = exudyn.LinearSolverType.EigenSparse

    def solve():
        system.SolveStatic(settings)
        p = system.GetNodeOutput(end, exudyn.OutputVariableType.Position)
        return [p[1], p[2], p[0]]

    return solve


for case in TASK["cases"]:
    for elements in case["elements"]:
        # The fewest load steps that converge are the fastest.
        for steps in case["load_steps"]:
            name = f"{case['name']}, {elements} elements, {steps} load step" + ("s" if steps > 1 else "")
            try:
                position, least = best(lambda: prepared(case, elements, steps))
            except Exception:
                if steps == case["load_steps"][-1]:
                    tell(task=case["name"], case=name, failed="does not converge")
                continue
            tell(task=case["name"], case=name, time_s=least, values=position)
            break
