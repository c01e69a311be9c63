"""How a machine rounds: a print of what its linear algebra and its functions give.

The same code gives other last digits on another kind of processor, and an estimator that draws
samples or stops when converged makes more of them. Run as a program it prints a digest, which is
the same wherever the recorded numbers can be expected to repeat.
"""

import hashlib
import math

import numpy as np
import scipy.linalg


def digest() -> str:
    """SHA-256 of the bytes of a few results of NumPy, SciPy and the mathematical library."""
    values = np.modf(np.arange(1, 1601).reshape(40, 40) * math.sqrt(2.0))[0] - 0.5
    square = values @ values.T + np.eye(40)
    results = [
        square,
        np.einsum("ij,jk->ik", values, square),
        np.linalg.solve(square, values),
        *np.linalg.svd(values),
        *np.linalg.eigh(square),
        scipy.linalg.expm(values / 10.0),
        *scipy.linalg.qr(values),
        *(function(values) for function in (np.sin, np.cos, np.exp, np.arctan, np.cbrt)),
        np.array([math.atan2(math.sin(x), math.exp(x)) for x in values.ravel()]),
        values.astype(np.float32) @ values.astype(np.float32),
    ]
    return hashlib.sha256(b"".join(result.tobytes() for result in results)).hexdigest()


if __name__ == "__main__":
    print(digest())
