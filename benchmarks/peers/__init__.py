"""Work and precision of this model beside solvers that a user could take instead."""
