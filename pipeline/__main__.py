"""`python -m pipeline` runs `drupe` where its script is not installed.

It is not safe in a folder where others can write: Python looks for `pipeline` there first, and would run
their `pipeline.py` before this package. `drupe` and `python -P -m pipeline` are safe there.
"""

from pipeline.start import main

if __name__ == "__main__":
    main()
