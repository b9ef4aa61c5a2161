"""What `kontur-av export` makes of a recording: tables for MATLAB, CSV files, Matroska files."""
