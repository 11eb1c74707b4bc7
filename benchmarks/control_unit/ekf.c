/* The rivals of the observer, for the cost of a step: the extended Kalman filter of the paper's references with all nodes among its
 * states (lpvobs.observer.ekf: outputs one after the other, lower triangle alone, rows without gain left out), and a local one that
 * keeps the covariance of states and four nodes, and of all other nodes their variance. LOCAL says which; both take signals as read.
 */
#include "lpvobs.h"
#include "ekf.h"

#define R(x) ((real_t)(x))
#define N LPVOBS_STATES
#ifdef LOCAL
#define P_NODES 4U
#else
#define P_NODES LPVOBS_NODES
#endif
#define SIZE (N + P_NODES)

static real_t P[SIZE][SIZE]; /* the lower triangle is kept up to date */
static real_t x[N];
static real_t theta[LPVOBS_NODES];
#ifdef LOCAL
static real_t variance[LPVOBS_NODES];
static uint32_t own[4];
#endif
static uint32_t begun = 0U;

const real_t *ekf_map(void)
{
    return theta;
}

uint32_t ekf_bytes(void)
{
    uint32_t bytes = (uint32_t)(sizeof(P) + sizeof(x) + sizeof(theta));
#ifdef LOCAL
    bytes += (uint32_t)(sizeof(variance) + sizeof(own));
#endif
    return bytes;
}

static uint32_t locate(const real_t nodes[], uint32_t count, real_t value, real_t *eta)
{
    uint32_t i = 0U;
    while ((i < (count - 2U)) && (value > nodes[i + 1U])) {
        i++;
    }
    *eta = (value - nodes[i]) / (nodes[i + 1U] - nodes[i]);
    *eta = (*eta < R(0.0)) ? R(0.0) : ((*eta > R(1.0)) ? R(1.0) : *eta);
    return i;
}

static void invert(real_t M[N][N], real_t T[N][N])
{
    uint32_t i;
    uint32_t j;
    real_t factor;
    for (i = 0U; i < N; i++) {
        for (j = 0U; j < N; j++) {
            const uint32_t a = (i + 1U) % N;
            const uint32_t b = (i + 2U) % N;
            const uint32_t c = (j + 1U) % N;
            const uint32_t d = (j + 2U) % N;
            T[j][i] = (M[a][c] * M[b][d]) - (M[a][d] * M[b][c]);
        }
    }
    factor = R(1.0) / ((M[0][0] * T[0][0]) + (M[0][1] * T[1][0]) + (M[0][2] * T[2][0]));
    for (i = 0U; i < N; i++) {
        for (j = 0U; j < N; j++) {
            T[i][j] *= factor;
        }
    }
}

/* P <- diag(F, I) P diag(F, I)^T, lower triangle. */
static void predict(real_t F[N][N])
{
    uint32_t i;
    uint32_t j;
    uint32_t m;
    real_t row[N];
    for (i = 0U; i < N; i++) {
        for (j = 0U; j < i; j++) {
            P[j][i] = P[i][j];
        }
    }
    for (i = 0U; i < SIZE; i++) {
        for (j = 0U; j < N; j++) {
            row[j] = P[i][j];
        }
        for (j = 0U; j < N; j++) {
            real_t total = R(0.0);
            for (m = 0U; m < N; m++) {
                total += F[j][m] * row[m];
            }
            P[i][j] = total;
        }
    }
    for (j = 0U; j < N; j++) {
        for (i = 0U; i < N; i++) {
            row[i] = P[i][j];
        }
        for (i = j; i < N; i++) {
            real_t total = R(0.0);
            for (m = 0U; m < N; m++) {
                total += F[i][m] * row[m];
            }
            P[i][j] = total;
        }
    }
}

static void add_row(uint32_t i, real_t factor, real_t row[SIZE])
{
    uint32_t j;
    for (j = 0U; j <= i; j++) {
        row[j] += factor * P[i][j];
    }
    for (j = i + 1U; j < SIZE; j++) {
        row[j] += factor * P[j][i];
    }
}

#ifdef LOCAL
/* Take the nodes of another cell into the covariance: what leaves keeps its variance, what stays keeps its covariance. */
static void change_cell(const uint32_t node[4])
{
    uint32_t m;
    uint32_t k;
    uint32_t i;
    real_t old[SIZE][SIZE];
    uint32_t from[SIZE] = {0U, 1U, 2U, SIZE, SIZE, SIZE, SIZE};
    for (m = 0U; m < 4U; m++) {
        variance[own[m]] = P[N + m][N + m];
    }
    for (i = 0U; i < SIZE; i++) {
        for (k = 0U; k < SIZE; k++) {
            old[i][k] = (k <= i) ? P[i][k] : P[k][i];
        }
    }
    for (m = 0U; m < 4U; m++) {
        for (k = 0U; k < 4U; k++) {
            if (own[k] == node[m]) {
                from[N + m] = N + k;
            }
        }
    }
    for (i = 0U; i < SIZE; i++) {
        for (k = 0U; k <= i; k++) {
            P[i][k] = ((from[i] < SIZE) && (from[k] < SIZE)) ? old[from[i]][from[k]] : R(0.0);
        }
        if (from[i] == SIZE) {
            P[i][i] = variance[node[i - N]];
        }
    }
    for (m = 0U; m < 4U; m++) {
        own[m] = node[m];
    }
}
#endif

void ekf_start(void)
{
    uint32_t i;
    for (i = 0U; i < P_NODES; i++) {
        P[N + i][N + i] = R(EKF_PRIOR) * R(EKF_PRIOR);
    }
#ifdef LOCAL
    for (i = 0U; i < LPVOBS_NODES; i++) {
        variance[i] = R(EKF_PRIOR) * R(EKF_PRIOR);
    }
    own[1] = 1U;
    own[2] = LPVOBS_FUEL_NODES;
    own[3] = LPVOBS_FUEL_NODES + 1U;
#endif
}

void ekf_step(const real_t u[LPVOBS_CHANNELS], real_t h)
{
    static real_t PH[LPVOBS_OUTPUTS][SIZE];
    static const real_t noise[LPVOBS_OUTPUTS] = EKF_MEASUREMENT;
    static const real_t drift[N] = EKF_PROCESS;
    real_t S[LPVOBS_OUTPUTS];
    real_t gain[LPVOBS_OUTPUTS];
    real_t M[N][N];
    real_t F[N][N];
    real_t driven[N];
    real_t weight[4];
    real_t eta_1;
    real_t eta_2;
    uint32_t node[4];
    uint32_t at[4];
    uint32_t i;
    uint32_t j;
    uint32_t m;
    uint32_t o;
    lpvobs_system sys;

    lpvobs_model(u, &sys);
    i = locate(lpvobs_fuel, LPVOBS_FUEL_NODES, u[LPVOBS_FUEL], &eta_1);
    j = locate(lpvobs_speed, LPVOBS_SPEED_NODES, u[LPVOBS_SPEED], &eta_2);
    for (m = 0U; m < 4U; m++) {
        node[m] = (j * LPVOBS_FUEL_NODES) + i + (m % 2U) + ((m / 2U) * LPVOBS_FUEL_NODES);
        weight[m] = (((m % 2U) == 1U) ? eta_1 : (R(1.0) - eta_1)) * (((m / 2U) == 1U) ? eta_2 : (R(1.0) - eta_2));
    }
#ifdef LOCAL
    if (node[0] != own[0]) {
        change_cell(node);
    }
    for (m = 0U; m < 4U; m++) {
        at[m] = N + m;
    }
#else
    for (m = 0U; m < 4U; m++) {
        at[m] = N + node[m];
    }
#endif
    if (begun == 0U) {
        lpvobs_measured(u, x);
        for (i = 0U; i < N; i++) {
            P[i][i] = drift[i] * drift[i];
        }
        begun = 1U;
    } else {
        for (i = 0U; i < N; i++) {
            for (j = 0U; j < N; j++) {
                M[i][j] = ((i == j) ? R(1.0) : R(0.0)) - (h * sys.A[i][j]);
            }
            driven[i] = x[i] + (h * sys.E[i]);
        }
        invert(M, F);
        for (i = 0U; i < N; i++) {
            x[i] = R(0.0);
            for (j = 0U; j < N; j++) {
                x[i] += F[i][j] * driven[j];
            }
        }
        predict(F);
        for (i = 0U; i < N; i++) {
            P[i][i] += h * (drift[i] * drift[i]);
        }
        for (m = 0U; m < 4U; m++) {
            if (weight[m] > R(0.0)) {
                P[at[m]][at[m]] += h * (R(EKF_DRIFT) * R(EKF_DRIFT));
            }
        }
    }
    for (o = 0U; o < LPVOBS_OUTPUTS; o++) {
        const uint32_t sensor = (o == (LPVOBS_OUTPUTS - 1U)) ? 1U : 0U;
        real_t c[N];
        real_t innovation = u[lpvobs_output_channel[o]];
        real_t spread = noise[o] * noise[o];
        real_t push;
        uint32_t earlier;
        for (i = 0U; i < SIZE; i++) {
            PH[o][i] = R(0.0);
        }
        for (j = 0U; j < N; j++) {
            c[j] = (sensor == 1U) ? sys.C_2[j] : ((lpvobs_output_state[o] == j) ? R(1.0) : R(0.0));
            if ((c[j] > R(0.0)) || (c[j] < R(0.0))) {
                innovation -= c[j] * x[j];
                add_row(j, c[j], PH[o]);
            }
        }
        for (m = 0U; (m < 4U) && (sensor == 1U); m++) {
            if (weight[m] > R(0.0)) {
                innovation -= weight[m] * theta[node[m]];
                add_row(at[m], weight[m], PH[o]);
            }
        }
        for (earlier = 0U; earlier < o; earlier++) {
            real_t taken = R(0.0);
            for (j = 0U; j < N; j++) {
                taken += c[j] * PH[earlier][j];
            }
            for (m = 0U; (m < 4U) && (sensor == 1U); m++) {
                taken += weight[m] * PH[earlier][at[m]];
            }
            taken /= S[earlier];
            if ((taken > R(0.0)) || (taken < R(0.0))) {
                for (i = 0U; i < SIZE; i++) {
                    PH[o][i] -= taken * PH[earlier][i];
                }
            }
        }
        for (j = 0U; j < N; j++) {
            spread += c[j] * PH[o][j];
        }
        for (m = 0U; (m < 4U) && (sensor == 1U); m++) {
            spread += weight[m] * PH[o][at[m]];
        }
        S[o] = spread;
        push = innovation / spread;
        for (i = 0U; i < N; i++) {
            x[i] += PH[o][i] * push;
        }
        for (i = 0U; i < P_NODES; i++) {
#ifdef LOCAL
            theta[own[i]] += PH[o][N + i] * push;
#else
            theta[i] += PH[o][N + i] * push;
#endif
        }
    }
    for (i = 0U; i < SIZE; i++) {
        uint32_t known = 0U;
        for (o = 0U; o < LPVOBS_OUTPUTS; o++) {
            gain[o] = PH[o][i] / S[o];
            known |= ((gain[o] > R(0.0)) || (gain[o] < R(0.0))) ? 1U : 0U;
        }
        for (j = 0U; (j <= i) && (known == 1U); j++) {
            for (o = 0U; o < LPVOBS_OUTPUTS; o++) {
                P[i][j] -= gain[o] * PH[o][j];
            }
        }
    }
}
