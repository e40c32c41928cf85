"""Detection statistics of sound recordings: fruits, noise, surfaces, pits and places drawn anew.

14 cases of four grasps, made by the samples' own contact solver on hexahedra
(`benchmarks/mismatch_bank.py FOLDER null`), 2026-11-20. One row per case, columns as in NAMES.
"""

NAMES = ("best single", "best pair", "what is left")
NULLS: tuple[tuple[float, ...], ...] = (
    (4.116, 6.794, 0.1139),
    (2.667, 10.31, 0.1151),
    (11.95, 18.85, 0.1158),
    (4.956, 9.023, 0.1146),
    (5.549, 16.95, 0.1133),
    (23.3, 26.18, 0.1129),
    (10.01, 17.26, 0.1134),
    (10.93, 13.37, 0.1113),
    (27, 33.06, 0.1133),
    (23.94, 31.39, 0.111),
    (26.45, 85.81, 0.1217),
    (48.89, 87.8, 0.1204),
    (11.74, 19.98, 0.1135),
    (10.43, 19.19, 0.1114),
)
