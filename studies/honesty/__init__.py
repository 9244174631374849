"""How honest the model's error estimates are: random runs, judged by references that share no code with the model.

`scenes.draw` makes a scene of a seed, `truth.reference` solves it (and keeps the solution on disk), `ours.model` is the
model's answer, `judging.judge` compares the two tick by tick. `kinds.STUDIES` names the studies, and `study.table` adds
up what their runs are worth.
"""
