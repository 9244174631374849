"""Damaged bags by the thousand: none may end in a traceback, hang, or give wrong answers without a word."""
