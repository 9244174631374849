"""Estimated loads and their split held against two instrumented knees, as docs/explanation/validation.md.

python -m studies.validation --data FOLDER
"""
