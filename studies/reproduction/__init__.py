"""What the paper reports and what this model gives for the same inputs, as docs/studies/reproduction.md.

python -m studies.reproduction
"""
