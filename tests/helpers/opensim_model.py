"""A small model for OpenSim: pelvis, thighs and shins, with a marker at each joint of a Kinect v2's legs."""

LEGS = {
    "pelvis": ("HipLeft", "HipRight"),
    "thigh_l": ("HipLeft", "KneeLeft"),
    "thigh_r": ("HipRight", "KneeRight"),
    "shin_l": ("KneeLeft", "AnkleLeft"),
    "shin_r": ("KneeRight", "AnkleRight"),
}
"""Which markers measure a body."""
_HALF, _LENGTH = 0.1, 0.5  # metres, of the pelvis and of each bone: nobody's


def write_legs(opensim, path):
    """Writes the model: x forward, y up, z right."""
    model, zero = opensim.Model(), opensim.Vec3(0)
    model.setName("legs")
    inertia = opensim.Inertia(0.1)
    bodies = {name: opensim.Body(name, 1.0, zero, inertia) for name in LEGS}
    for body in bodies.values():
        model.addBody(body)
    model.addJoint(opensim.FreeJoint("ground_pelvis", model.getGround(), bodies["pelvis"]))
    for side, letter, z in (("Left", "l", -_HALF), ("Right", "r", _HALF)):
        thigh, shin = bodies[f"thigh_{letter}"], bodies[f"shin_{letter}"]
        below, hip = opensim.Vec3(0, -_LENGTH, 0), opensim.Vec3(0, 0, z)
        model.addJoint(opensim.BallJoint(f"hip_{letter}", bodies["pelvis"], hip, zero, thigh, zero, zero))
        knee = opensim.PinJoint(f"knee_{letter}", thigh, below, zero, shin, zero, zero)
        knee.updCoordinate().setName(f"knee_{letter}")
        model.addJoint(knee)
        for joint, body, place in (
            ("Hip", bodies["pelvis"], hip),
            ("Knee", thigh, below),
            ("Ankle", shin, below),
        ):
            model.addMarker(opensim.Marker(f"{joint}{side}", body, place))
    model.finalizeConnections()
    model.printToXML(str(path))
