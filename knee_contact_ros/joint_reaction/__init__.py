"""The joint reaction force of the knee from a leg's sensors: angles, ground force, assistance."""
