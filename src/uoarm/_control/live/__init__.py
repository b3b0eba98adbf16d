"""What is open now: components, edges and the application's ports, and who watches them."""
