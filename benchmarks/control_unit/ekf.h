/* EKF_PRIOR, EKF_DRIFT, EKF_MEASUREMENT and EKF_PROCESS are given on the command line, from the configuration's [ekf]. */
#ifndef EKF_H
#define EKF_H
#include "lpvobs.h"
void ekf_start(void);
void ekf_step(const real_t u[LPVOBS_CHANNELS], real_t h);
const real_t *ekf_map(void);
uint32_t ekf_bytes(void);
#endif
