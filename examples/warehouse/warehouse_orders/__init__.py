"""The application: it takes transport orders, and has whichever vehicle is fit carry them out."""
