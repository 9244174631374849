"""The model and its shares held against an instrumented knee, as docs/validation.md.

python -m studies.validation --data FOLDER
"""
