"""How long a drive stayed in each cell and what its residuals added up to there, visit by visit, cell by cell, in plain loops."""

import numpy as np


def visits(cells, steps, longest):
    """Return (cell, samples) of every visit of one segment: consecutive samples in a cell, cut once it has lasted `longest`."""
    found, members, stay = [], [], 0.0
    for k, cell in enumerate(cells):
        members.append(k)
        stay += steps[k]
        if k + 1 == len(cells) or cells[k + 1] != cell or stay >= longest:
            found.append((cell, members))
            members, stay = [], 0.0
    return found


def pooled(values, rows, columns):
    """Return values per cell, averaged over neighbours with a Gaussian of one cell, three cells wide; nothing lies outside."""
    kernel = np.exp(-0.5 * np.arange(-3, 4) ** 2)
    kernel /= kernel.sum()
    shaped = np.asarray(values).reshape(rows, columns, -1)
    out = np.zeros_like(shaped)
    for j in range(rows):
        for i in range(columns):
            for dj in range(-3, 4):
                for di in range(-3, 4):
                    if 0 <= j + dj < rows and 0 <= i + di < columns:
                        out[j, i] += kernel[dj + 3] * kernel[di + 3] * shaped[j + dj, i + di]
    return out.reshape(np.asarray(values).shape)


def covariances(
    residual, slope, constants_variance, steps, cells, segments, rows, columns, longest, least_time, least_density
):
    """Return per cell the spectral density of the B residuals, and the covariance of their averages, constants included."""
    B, q, _ = slope.shape
    count = rows * columns
    power, spent, mean = np.zeros((count, B, B)), np.zeros(count), np.zeros((count, B, q))
    for start, stop in segments:
        for cell, members in visits(cells[start:stop], steps[start:stop], longest):
            at = start + np.array(members)
            integral = residual[:, at] @ steps[at]
            power[cell] += np.outer(integral, integral)
            spent[cell] += steps[at].sum()
            mean[cell] += slope[:, :, at] @ steps[at]
    time = pooled(spent, rows, columns) + least_time
    density = (pooled(power, rows, columns) + least_time * power.sum(axis=0) / spent.sum()) / time[:, None, None]
    density = density + least_density * np.eye(B)
    mean = pooled(mean, rows, columns) / time[:, None, None]
    constant = np.array([m @ np.diag(constants_variance) @ m.T for m in mean])
    return density, density / time[:, None, None] + constant


def evidence(residual, slope, steps, cells, segments, count, longest):
    """Return power and number of the visits to each cell, the time spent and the integral of the slopes there."""
    B, q, _ = slope.shape
    power, number, spent = np.zeros((count, B, B)), np.zeros(count), np.zeros(count)
    total = np.zeros((count, B, q))
    for start, stop in segments:
        for cell, members in visits(cells[start:stop], steps[start:stop], longest):
            at = start + np.array(members)
            integral = residual[:, at] @ steps[at]
            power[cell] += np.outer(integral, integral)
            number[cell] += 1.0
            spent[cell] += steps[at].sum()
            total[cell] += slope[:, :, at] @ steps[at]
    return power, spent, number, total
