"""The app: results to look through, and a page to choose a scan with sliders; needs the extra ``app``."""
