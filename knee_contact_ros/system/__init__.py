"""What any program needs: errors, files, processes, the terminal."""
