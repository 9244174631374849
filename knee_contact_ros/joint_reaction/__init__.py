"""The joint reaction force of the knee from what a leg's sensors tell: angles, ground force, assistance."""
