"""The compiled kernel: the same source as the plain one, the same bits, some hundred times quicker.

`choice.py` says when it is worth its compiling. All else is imported only where something is compiled or loaded.
"""
