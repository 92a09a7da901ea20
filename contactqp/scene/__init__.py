r"""Case files: their keys, units and checks, the contact problem they state, and what they claim of its answer.

A case is TOML, and its keys are the fields of `schema.SceneData`; every number with a dimension carries its unit::

    title = "A bar and a rigid wall"
    units = { length = "m", force = "kN" }      # what answers are given in; SI without it
    axes = ["x"]                                # one, two or three of x, y, z
    nodes = [{ name = "support", at = ["0 m"] }, { name = "1", at = ["2 m"] }]
    bars = [{ name = "bar", nodes = ["support", "1"], area = "15 cm^2", modulus = "210 GPa" }]
    fixed = ["support"]                         # a node, or one unknown: "support.x"
    obstacles = [{ name = "wall", point = ["2001 mm"], normal = [-1] }]
    contacts = [{ name = "tip", node = "1", obstacle = "wall" }]
    loads = [{ unknown = "1.x", value = "300 kN" }]

    [[expect]]                                  # claims.QUANTITIES lists what can be asked
    quantity = "normal force"
    at = "tip"
    value = "285/2 kN"
    derivation = "P - K g"

In place of nodes a scene may have elastic ``bodies`` or ``membranes``, whose keys are in schema_bodies::

    axes = ["x", "y"]
    bodies = [{ name = "block", shape = { kind = "rectangle", element = "quad4", size = ["2 mm", "1 mm"], \
        divisions = [8, 4] }, model = "plane-strain", thickness = "1 mm", modulus = "210 GPa", poisson = 0.3 }]
    contacts = [{ name = "foot", side = "block.bottom", obstacle = "floor" }]
    supports = [{ name = "symmetry", on = "block.left", axis = "x" }]
    pressures = [{ name = "press", side = "block.top", value = "100 MPa" }]

With friction the answer depends on the path of the loads, from corner to corner::

    contacts = [{ name = "foot", node = "1", obstacle = "floor", friction = 0.3 }]
    loads = [
        { name = "weight", unknown = "1.z", value = "-1 kN" },
        { name = "push", unknown = "1.x", value = "400 N" },
    ]

    [path]
    events = "exact"
    corners = [{ weight = 1 }, { weight = 1, push = 1 }, { weight = 1 }]   # factors of the loads, 0 by default

    [[expect]]
    quantity = "friction force"
    at = "foot"
    along = "x"
    time = 2                                # the second corner; without it the end
    value = "300 N"
    derivation = "mu times the weight"

A scene with a motion moves in time, under constant loads::

    bars = [{ name = "rod", nodes = ["a", "b"], area = "2 cm^2", modulus = "210 GPa", density = "7850 kg/m^3", \
        divisions = 50 }]

    [motion]                                # its keys are those of schema.Motion
    duration = "1 ms"
    time_step = "2 us"
    scheme = "moreau-jean"                  # one of contactqp.impact
    velocities = [{ of = "rod", value = ["3 m/s"] }]

    [[expect]]
    quantity = "velocity"
    at = "b.x"
    time = "0.5 ms"                         # a time with its unit: the end of the last step before it
    value = "3 m/s"
    derivation = "nothing touches it yet"

With large displacements contacts and bars follow the deformed geometry, and the path may be controlled::

    deformation = "large"
    bars = [{ name = "bar", nodes = ["a", "b"], area = "1 cm^2", modulus = "10 MPa", law = "green" }]

    [path]
    control = "displacement"                # or "load", which is the default, or "arc-length" with its arc_length
    controlled = "b.z"
    target = "-18 cm"
    steps = 20

    [[expect]]
    quantity = "limit load"
    at = "b.z"
    value = "-4.0712153 N"
    tolerance = 1e-7
    derivation = "2 sqrt(3) / 9 E A0 h^3 / L0^3"

Unknowns are called ``node.axis``, and ``node.theta`` where a beam ends. The other blocks are ``springs``, ``beams``,
``strings`` with ``line_loads``, ``masses`` with ``gravity``, ``matrices``, ``ties``, ``study``, ``published`` and
``remarks``.
"""
