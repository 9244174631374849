"""General services of a program: errors, files, processes, the terminal."""
