"""The two ways in which the computer reaches the car (design section 14), behind one protocol. No Drake."""
