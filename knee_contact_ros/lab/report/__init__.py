"""`knee-contact report`: figures and tables for people without a viewer."""
