"""Invalid tables of recipes, each with the key that its error names."""

from __future__ import annotations

VIEWS = [
    ('[views]\nkind = "circle"', "views.kind"),
    ("[views]\nkind = { arc = 0.5, path = 0.5 }", "views.kind"),
    ('[[views]]\nkind = "arc"', "views"),
    ('[views]\nkind = "random"', "views.target"),
    ('[views]\ndistance_mm = "far"', "views.distance_mm"),
    ('[views]\ndistance_mm = { per = "frame" }', "views.distance_mm"),
    ("[views]\ndistance_mm = { low = 3, high = 500 }", "views.distance_mm = 3.0"),
    ("[views]\nazimuth_deg = { uniform = [-30, 30] }", "views.azimuth_deg"),
    ("[views]\nazimuth_deg = [0, { uniform = [0, 300] }]", "views.azimuth_deg.1 = 300.0"),
    ("[views]\nspeed_mm_s = 1e400", "views.speed_mm_s"),
    ('[views]\nkind = "protocol"\ndistance_mm = []\nazimuth_deg = [0]\nheight_mm = 1\n'
    'pitch_deg = 0', "views.d"),
    ('[views]\nkind = "protocol"\ndistance_mm = 400\nazimuth_deg = [0]\nheight_mm = 1\n'
    'pitch_deg = 0', "views.d"),
    ('plan.frames = 7\n[views]\nkind = "grid"\ndistance_mm = [400]\nheight_mm = [900]', "plan.frames = 7"),
    ('[views]\nkind = "poses"\nfile = "missing.txt"', "views.file"),
    ('[views]\nkind = "poses"\nfile = { "missing.txt" = 0.5, "other.txt" = 0.5 }', "views.file"),
    ('[views]\nkind = "path"\npoints_mm = [[0, 0, 0], [100, 0]]\nspeed_mm_s = 1', "views.points_mm.1.2"),
    ('[views]\nkind = "path"\npoints_mm = [[0, 0, 0], [0, 0, 0]]\nspeed_mm_s = 1', "views"),
    ('[views]\nkind = "path"\npoints_mm = [[0, 0, 0], [1, 0, 0]]\nspeed_mm_s = 1', "plan.frames"),
    (
        '[views]\nkind = "path"\npoints_mm = [[0, 0, 0], [90000, 0, 0]]\nspeed_mm_s = 0.01\n'
        'frame_rate_hz = 100',
        "views.points_mm",
    ),
    (
        '[views]\nkind = "path"\npoints_mm = [[0, 0, 0], [900, 0, 0]]\nframe_rate_hz = 10\n'
        "speed_mm_s = { low = 10, high = 90 }",
        "views",
    ),
    ('plan.frames = 2\n[views]\nkind = "random"\ndistance_mm = [300, 500]\n'
    'target = "fruits"', "views.target"),
    (
        'plan.frames = 2\n[views]\nkind = "random"\ndistance_mm = [300, 500]\n'
        'target = { fruit = 0.9, frut = 0.1 }',
        "views.target = 'frut'",
    ),
    ('plan.frames = 2\n[views]\nkind = "random"\ndistance_mm = [500, 300]\ntarget = "fruit"', "views"),
    (
        'plan.frames = 2\n[views]\nkind = "random"\ntarget = "fruit"\n'
        "distance_mm = [{ low = 200, high = 400 }, { low = 300, high = 500 }]",
        "views",
    ),
    ('plan.frames = 2\n[views]\nkind = "function"\nfile = "missing.py"', "views.file"),
]  # fmt: skip

VARIED = [
    ("camera.exposure_us = { low = 0, high = 50 }", "camera.exposure_us = 0.0"),
    ("camera.exposure_us = { auto = 0.5, 50 = 0.4 }", "camera.exposure_us"),
    ("camera.exposure_us = { auto = 0.5, fast = 0.5 }", "camera.exposure_us = 'fast'"),
    ("camera.exposure_us = { in_turn = [] }", "camera.exposure_us"),
    ("camera.exposure_us = { in_turn = [{ low = 1, high = 2 }] }", "camera.exposure_us"),
    ("camera.exposure_us = { in_turn = [50], draw = 'a' }", "camera.exposure_us"),
    ("camera.exposure_us = { mean = 50 }", "camera.exposure_us"),
    ("camera.exposure_us = { mean = 50, sd = -1 }", "camera.exposure_us"),
    ("camera.exposure_us = { mean = 50, sd = 1, low = 60, high = 70 }", "camera.exposure_us"),
    ("camera.exposure_us = { mean = 50, sd = 1, per = 'year' }", "camera.exposure_us"),
    ("camera.exposure_us = { mean = 50, sd = 1, reversed = 1 }", "camera.exposure_us"),
    ("camera.exposure_us = { mean = 50, sd = 1, scale = 'log' }", "camera.exposure_us"),
    ("camera.exposure_us = { low = 60, high = 50 }", "camera.exposure_us"),
    ("camera.exposure_us = { low = 0, high = 50, scale = 'log' }", "camera.exposure_us"),
    ("camera.exposure_us = { uniform = [1, 2, 3] }", "camera.exposure_us"),
    ("camera.exposure_us = { histogram = [[1, 2]] }", "camera.exposure_us"),
    ("views.pitch_deg = { histogram = [[0, 0, 0.3], [1, 2, 0.7]] }", "views.pitch_deg"),
    ("camera.exposure_us = { mean_mm = 50, sd_mm = 1 }", "camera.exposure_us"),
    ("camera.exposure_us = { low = 20, high = 2016-05-01 }", "camera.exposure_us"),
    ("camera.exposure_us = 9223372036854775808", "camera.exposure_us"),
    ("camera.sensor = { ueye_ui5250re = 0.99, nikn = 0.01 }", "camera.sensor = 'nikn'"),
    ("camera.flash = { none = 0.5, led_matrix_200klx = 0.5 }", "camera.flash = 'none'"),
    ("camera.focus_mm = { low = 1, high = 500 }", "camera.focus_mm = 1.0"),
    ("camera.width = { low = 100, high = 200 }", "camera"),
    ("camera.width = { low = 100, high = 5000 }\ncamera.height = 100", "camera.width"),
    ("camera.bits = { low = 8.5, high = 12 }", "camera.bits"),
    ("camera.calibration = { 'a.yaml' = 0.5, 'b.yaml' = 0.5 }", "camera.calibration"),
    (
        "camera.focus_mm = { low = 300, high = 500, draw = 'a' }\n"
        "camera.gain = { low = 1, high = 2, draw = 'a', per = 'set' }",
        "camera.gain.per",
    ),
    ("developing.white_balance_error = [{ mean = 1, sd = 0.1 }, 1]", "developing.white_balance_error.2"),
    ("developing.white_balance_error = { mean = 1, sd = 0.1 }", "developing.white_balance_error"),
    ("developing.falloff = { true = 0.5, maybe = 0.5 }", "developing.falloff = 'maybe'"),
    ("auto_exposure.target_grey = { low = 0, high = 100 }", "auto_exposure.target_grey = 0.0"),
    ("auto_exposure.exposure_us = [{ low = 10, high = 200 }, 150]", "auto_exposure"),
    (
        "daylight.illuminance_lx = { low = 100, high = 200000 }\n"
        "daylight.sun_fraction = { low = 0, high = 0.95 }\n"
        "daylight.sun_elevation_deg = { low = 10, high = 60 }",
        "daylight",
    ),
    ("twine.diameter_mm = { low = 0, high = 4 }", "twine.diameter_mm"),
    ("plan.rotations = { low = 1, high = 3 }", "plan.rotations"),
    ("plan.twins = 3", "plan.twins"),
    ("seed = { in_turn = [1, 2] }", "seed"),
    ("row.plants_front = { low = 1, high = 60 }", "row.plants_front = 60"),
    ("greenhouse.gutter_width_mm = { low = 300, high = 400 }", "greenhouse.gutter_width_mm"),
    ("cultivar = 'kaite'\n[growth]\nuntil = { kaite_september = 0.5, tomato = 0.5 }\n"
    "share = 0.5", "growth.until"),
    (
        "cultivar = 'kaite'\n[growth]\nuntil = 'kaite_september'\n"
        "date = { low = 2016-05-01, high = 2017-05-01 }",
        "growth.date",
    ),
    ("override.organs.fruit.scan = 'fruit.obj'", "override.organs.fruit.scan = 'fruit.obj'"),
    ("override.pigments.fruit.ior = 1.4", "override.pigments.fruit.start"),
    ("override.stem.parts = { low = -3, high = 5, per = 'set' }", "override.stem.parts = -3"),
    (
        "[override.organs.fruit.diameter]\nmean_mm = { low = 1, high = 80, per = 'set' }\n"
        "sd_mm = 3\nchosen = 'x'",
        "override.organs.fruit.diameter",
    ),
]  # fmt: skip

TWINS = [
    ("twins = 3", "twins"),
    ("[twins]\n'camera.gain' = [1]", "twins"),
    ("[twins]\n'camera.gain' = [1, 2]\n'camera.bits' = [8, 10, 12]", "twins"),
    ("[twins]\n'camera.gan' = [1, 2]", 'twins."camera.gan"'),
    ("[twins]\n'seed' = [1, 2]", "twins.seed"),
    ("[twins]\n'views.kind' = ['arc', 'poses']", 'twins."views.kind"'),
    ("[twins]\n'camera.gain' = [1, { low = 1, high = 2 }]", 'twins."camera.gain"'),
    ("[twins]\n'growth.date' = [2016-05-01, 2016-06-01]", 'twins."growth.date"'),
    (
        "cultivar = 'kaite'\ngrowth = { until = 'kaite_september', date = 2016-05-01 }\n"
        "[twins]\n'growth.date' = [2016-05-01, 2016-06-01, 2018-07-01]",
        'twins."growth.date"',
    ),
    ("[twins]\n'override.organs.fruit.diameter.mean_mm' = [50, 60]", 'twins."override.organs.fruit'),
    ("[twins]\n'camera.hfov_deg' = [50, 60]", 'twins."camera.hfov_deg": makes camera invalid: lens and'),
    ("[twins]\n"
    "'developing.white_balance_error' = [[1, 1, 1], [1, 1]]", 'twins."developing.white_balance_error"'),
]  # fmt: skip

RIG = [
    ("rig = 3", "rig"),
    ("\n".join(f"[[rig]]\nname = 'c{number}'" for number in range(64)), "rig"),
    ("[[rig]]\nname = 'main'", "rig.0.name"),
    ("[[rig]]\nname = 'a'\n[[rig]]\nname = 'a'", "rig.1.name"),
    ("[[rig]]\nname = 'a'\nposition_mm = [0, 0, { low = 1, high = 2 }]", "rig.0.position_mm.2"),
    ("[[rig]]\nname = 'a'\nrotation_deg = [0, 0, 400]", "rig.0.rotation_deg.2"),
    ("[[rig]]\nname = 'a'\nsensor = 'nikn'", "rig.0.sensor = 'nikn'"),
    ("[[rig]]\nname = 'a'\nsensor = 'generic_rgb'", "rig.0"),
    ("[[rig]]\nname = 'a'\ngain = { low = 1, high = 2 }", "rig.0.gain"),
    ("[[rig]]\nname = 'a'\nfocus_mm = 1", "rig.0.focus_mm = 1"),
    ("[[rig]]\nname = 'a'\nhfov_deg = 60\nlens = 'lensagon_cmfa0420nd'", "rig.0"),
    ("[[rig]]\nname = 'a'\n[rig.views]\nkind = 'arc'", "rig.0.views"),
]  # fmt: skip

INVALID = [*VIEWS, *VARIED, *TWINS, *RIG]
