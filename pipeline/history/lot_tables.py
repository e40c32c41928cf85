"""The tables of a store as queries name them: lots, grippers and sensors, and every revision of batches,
fruit and their grasps. The steps in `migrations/versions` define them; a new column needs a step there.

`revision`, `fruit` and `conversion` have the SHA-256 of all that a row says, rows that it refers to included;
`whole` has the SHA-256 of all those, by which a lost row is noticed. Days are ISO 8601 text, as SQLite has
them. Columns in JSON: `limits`, `listed` and `columns`.
"""

from sqlalchemy import Boolean, TableClause, column, table

KEY = ("batch", "fruit_id", "revision")
"""Of fruit; a batch has no `fruit_id`."""
CONVERSION_KEY = ("scale", "group", "version")


def _table(name: str, *columns: str, logical: str = "") -> TableClause:
    """`logical`: a column of true and false."""
    added = [column(logical, Boolean)] if logical else []
    return table(name, *map(column, columns), *added)


LOT = _table("lot", "id", "category", "cultivar", "lot", "orchard")
GRIPPER = _table("gripper", "id", "gripper", "gripper_serial")
SENSOR = _table("sensor", "id", "sensor", "sensor_serial", "calibration", "calibrated_on")
REVISION = _table(
    *(
        "revision",
        "batch",
        "revision",
        "graded_utc",
        "lot_id",
        "gripper_id",
        "sensor_id",
        "folder",
        "measured",
    ),
    *("harvest", "operator", "limits", "listed", "temperature_C", "sha256"),
    logical="dated",
)
FRUIT = _table(
    *("fruit", *KEY, "graded_utc", "E_MPa", "E_sd_MPa", "E_known_MPa", "E_known_sd_MPa", "shore_oo"),
    *("penetrometer_N", "columns", "sha256"),
    logical="doubted",
)
GRASP = _table("grasp", *KEY, "position", "grasp", "recording", "E_MPa", "E_sd_MPa", "peak_force_N")
CONVERSION = _table(
    *("conversion", *CONVERSION_KEY, "fitted_utc", "fruit", "intercept", "slope", "slope_sd", "residual_sd"),
    *("mean_ln_E", "squares", "E_low_MPa", "E_high_MPa", "sha256"),
)
WHOLE = _table("whole", "sha256")
TABLES = (LOT, GRIPPER, SENSOR, REVISION, FRUIT, GRASP, CONVERSION, WHOLE)
