"""The batch.toml that `drupe new` writes: every key, commented out, with its meaning, unit and default."""

TEMPLATE = """\
# Settings of this batch. Only `category` is required; take the # away from what you need.
# What each key means, with its limits: docs/formats.md, "Settings, batch.toml".

category = "{category}"              # {known}, or a file of your own
# cultivar = "Big Top"               # for the report and `drupe history`
# lot = "H-07"
# orchard = "north slope"
# operator = "A. Meier"
# packer = "Huber Obst"             # for the printed sheets
# harvest_date = 2026-08-14
# measured_on = 2026-08-15           # day of the grasps; default: of the first grading
# pulp_temperature_C = 20.0          # at the grasps, -5 to 50
# notes = "north rows"
# poisson_ratio = 0.45               # of the flesh, 0.1 to 0.4999; default: the category's
# poisson_ratio_sd = 0.02
# calibration_days = 90              # warn of an older calibration of sensor or rig
# rig = "rig.toml"                   # machine compliance of the jaws, from `drupe calibrate --rigid`

# [temperature]                      # E as it would be at another temperature than pulp_temperature_C
# reference_C = 20.0
# E_per_C = -0.012                   # your own relative change of E per degree, d ln E / dT
# E_per_C_sd = 0.004                 # its standard deviation, which widens the error bar

# [grading]
# certainty = 0.9                    # probability from which ship, hold and a class count as certain
# inspect_below_p = 0.001            # fruit whose screen has a smaller p are to be inspected
# [[grading.classes]]                # maturity classes, softest first; without them there are none
# name = "ready to eat"
# E_max_MPa = 0.35                   # every fruit up to this modulus, MPa
# ship = true                        # default: all classes but the firmest are shipped
# [[grading.classes]]
# name = "unripe"                    # the last class has no E_max_MPa
# ship = false

# [sensor]                           # the tactile sensor, for the record
# name = "20x20 marker gel"
# serial = "A-117"
# gel_scale_sd = 0.02                # relative standard deviation of single markers' displacement
# force_scale_sd = 0.02              # of single markers' force
# pose_sd_mm = 0.2                   # of a pad's place along the skin
# common_scale_sd = 0.03             # of a common factor on force and gel stiffness
# picture_scale_sd = 0.05            # of the scale of the gel's pictures
# gel_kn_MPa_per_mm = 0.22           # known stiffness of the gel, which recordings are compared with
# gel_kt_MPa_per_mm = 0.055
# gel_stiffness_sd = 0.05            # relative standard deviation of both
# calibration = "C-2026-06"          # for `drupe history`
# calibrated_on = 2026-06-01         # for `drupe history` and calibration_days

# [gripper]
# name = "two-finger gripper"
# serial = "G-3"

# [columns]                          # your own columns of fruits.csv, each with its unit
# Brix = "°Brix"                     # with a unit it holds numbers
# grower = ""                        # without a unit it holds text

# [photos]
# coin = "1 euro"                    # a coin beside the fruit gives the scale where there is no mat
# coin_mm = 23.25                    # or its diameter, 10 to 50 mm

# [pit]
# prior = "nectarine"                # another category, a TOML, STL, PLY or OBJ, or "none"
# offset_sd_mm = 0.5                 # how far the true pit may be from it; default: the prior's
# size_sd = 0.03

# [recon]
# geometry_model = "vggt.onnx"       # a local model for the cameras, relative to this file; default: none
# fruit_model = true                 # ask the shipped model which pixels are fruit
# providers = ["CPUExecutionProvider"]
# max_faces = 8000                   # triangles of the skin, 1000 to 100000

# [mesh]
# edge_mm = 5.0                      # finite elements inside, 1 to 20 mm
# pad_edge_mm = 1.5                  # under the pads, 0.3 to 10 mm; default: a fifth of each contact's width

# [flesh]
# model = "neo-hookean"              # or "linear": small strain, quicker, E 1 to 10 % too high

# [reference]                        # where a row of fruits.csv is a body of known modulus
# correct = false                    # divide every E by what the body shows
# chart = "control-chart.csv"        # to which each batch adds what was read

# [[mismatch]]                       # an effect that is confirmed; `drupe explain --apply` writes it
# effect = "viscoelastic"
"""
