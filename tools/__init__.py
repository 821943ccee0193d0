"""What is run beside the product: benchmarks, fuzzing, mutation."""
