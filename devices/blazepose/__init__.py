"""The program's own body tracker: BlazePose on infrared or colour images, lifted to space with depth."""
