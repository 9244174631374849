"""From what an implant measured to the table of `load.share_file`."""
