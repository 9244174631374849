"""The joint reaction estimated from sensors, held against an instrumented knee and OpenSim, as docs/load-validation.md.

python -m studies.load_validation --data FOLDER [--opensim MODEL_FOLDER]
"""
