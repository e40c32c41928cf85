"""`python -m pipeline`: `drupe`, started where its script is not at hand.

Not in a folder of strangers: Python looks for `pipeline` there first, and would run a `pipeline.py` of theirs
before a line of this package. `drupe` and `python -P -m pipeline` do not.
"""

from pipeline.start import main

if __name__ == "__main__":
    main()
