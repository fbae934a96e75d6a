"""What leaves the zoo to be read elsewhere: cards, and policies in other formats."""
