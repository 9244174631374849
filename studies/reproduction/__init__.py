"""What the paper reports and what this model gives for the same inputs, as docs/reproduction.md.

python -m studies.reproduction
"""
