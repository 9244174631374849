"""How honest the model's error estimates are: random scenes, judged by the reference.

`scenes.draw` makes a scene of a seed, `truth.reference` solves it (and keeps the solution on disk), `ours.model` is the
model's answer, `judging.judge` compares the two tick by tick; `study.study` does all of it for many seeds.
"""
