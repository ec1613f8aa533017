"""IMU and GPS of the car: bytes as pure functions, and the threads that read them. No Drake."""
