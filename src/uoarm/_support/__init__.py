"""What every layer uses: worker threads, deadlines, YAML with places, certificates, files."""
