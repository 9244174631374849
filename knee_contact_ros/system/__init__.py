"""General services of a program: errors, files and their formats, processes, the terminal."""
