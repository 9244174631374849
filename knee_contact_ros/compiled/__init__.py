"""The compiled kernel: made from the same source as the plain one, with the same bits, some hundred times faster.

`choice.py` decides when compiling is worthwhile. All else is imported only where something is compiled or loaded.
"""
