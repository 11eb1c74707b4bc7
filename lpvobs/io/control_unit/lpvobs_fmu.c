/* The observer as a unit for co-simulation, FMI 2.0: a communication step takes the sample that the inputs hold at its beginning.
 *
 * The types are those of the standard (fmi-standard.org, FMI 2.0.4, Sec. 2.1), written out as far as they are needed.
 */
#include <stddef.h>
#include <string.h>

#include "lpvobs.h"

#define OK 0
#define ERROR 3
#define AFTER_STATES ((fmi2ValueReference)(LPVOBS_CHANNELS + LPVOBS_STATES))
#define FLAGS (AFTER_STATES + 3U + (fmi2ValueReference)LPVOBS_NODES)
#define EXPORT __attribute__((visibility("default")))

typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef unsigned int fmi2ValueReference;
typedef int fmi2Status;

typedef struct {
    void (*logger)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, fmi2Status);
    void *componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
    lpvobs_state state;
    lpvobs_inputs inputs;
    lpvobs_outputs outputs;
} variables;

typedef struct {
    variables now;
    const fmi2CallbackFunctions *functions;
} component;

/* References: the channels first, then states, map value, innovation, time of the state, nodes; then, a whole number, the flags. */
static double value_of(const variables *v, fmi2ValueReference r)
{
    double value;
    if (r < (fmi2ValueReference)LPVOBS_CHANNELS) {
        value = (double)v->inputs.channel[r];
    } else if (r < AFTER_STATES) {
        value = (double)v->outputs.x[r - LPVOBS_CHANNELS];
    } else if (r == AFTER_STATES) {
        value = (double)v->outputs.map_value;
    } else if (r == (AFTER_STATES + 1U)) {
        value = (double)v->outputs.innovation;
    } else if (r == (AFTER_STATES + 2U)) {
        value = v->outputs.time;
    } else {
        value = (double)v->state.theta[r - (AFTER_STATES + 3U)];
    }
    return value;
}

EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORT void *fmi2Instantiate(fmi2String name, int kind, fmi2String guid, fmi2String place,
                             const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    component *c = NULL;
    (void)name;
    (void)place;
    (void)visible;
    (void)logging;
    if ((kind == 1) && (functions != NULL) && (strcmp(guid, lpvobs_version) == 0)) {
        c = functions->allocateMemory(1U, sizeof(component));
    }
    if (c != NULL) {
        lpvobs_init(&c->now.state);
        c->functions = functions;
    }
    return c;
}

EXPORT void fmi2FreeInstance(void *instance)
{
    component *c = instance;
    if (c != NULL) {
        c->functions->freeMemory(c);
    }
}

EXPORT fmi2Status fmi2Reset(void *instance)
{
    component *c = instance;
    static const variables nothing;
    c->now = nothing;
    lpvobs_init(&c->now.state);
    return OK;
}

EXPORT fmi2Status fmi2GetReal(void *instance, const fmi2ValueReference r[], size_t count, fmi2Real value[])
{
    const component *c = instance;
    fmi2Status status = OK;
    size_t i;
    for (i = 0U; i < count; i++) {
        if (r[i] < FLAGS) {
            value[i] = value_of(&c->now, r[i]);
        } else {
            status = ERROR;
        }
    }
    return status;
}

EXPORT fmi2Status fmi2SetReal(void *instance, const fmi2ValueReference r[], size_t count, const fmi2Real value[])
{
    component *c = instance;
    fmi2Status status = OK;
    size_t i;
    for (i = 0U; i < count; i++) {
        if (r[i] < (fmi2ValueReference)LPVOBS_CHANNELS) {
            c->now.inputs.channel[r[i]] = (real_t)value[i];
        } else {
            status = ERROR;
        }
    }
    return status;
}

EXPORT fmi2Status fmi2GetInteger(void *instance, const fmi2ValueReference r[], size_t count, fmi2Integer value[])
{
    const component *c = instance;
    fmi2Status status = OK;
    size_t i;
    for (i = 0U; i < count; i++) {
        if (r[i] == FLAGS) {
            value[i] = (fmi2Integer)c->now.outputs.flags;
        } else {
            status = ERROR;
        }
    }
    return status;
}

EXPORT fmi2Status fmi2DoStep(void *instance, fmi2Real time, fmi2Real step, fmi2Boolean final)
{
    component *c = instance;
    (void)step;
    (void)final;
    c->now.inputs.time = time;
    lpvobs_step(&c->now.inputs, &c->now.state, &c->now.outputs);
    return OK;
}

EXPORT fmi2Status fmi2GetFMUstate(void *instance, void **kept)
{
    const component *c = instance;
    if (*kept == NULL) {
        *kept = c->functions->allocateMemory(1U, sizeof(variables));
    }
    if (*kept != NULL) {
        memcpy(*kept, &c->now, sizeof(variables));
    }
    return (*kept != NULL) ? OK : ERROR;
}

EXPORT fmi2Status fmi2SetFMUstate(void *instance, const void *kept)
{
    component *c = instance;
    memcpy(&c->now, kept, sizeof(variables));
    return OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(void *instance, void **kept)
{
    const component *c = instance;
    c->functions->freeMemory(*kept);
    *kept = NULL;
    return OK;
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(void *instance, void *kept, size_t *size)
{
    (void)instance;
    (void)kept;
    *size = sizeof(variables);
    return OK;
}

EXPORT fmi2Status fmi2SerializeFMUstate(void *instance, const void *kept, char bytes[], size_t size)
{
    (void)instance;
    if (size >= sizeof(variables)) {
        memcpy(bytes, kept, sizeof(variables));
    }
    return (size >= sizeof(variables)) ? OK : ERROR;
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(void *instance, const char bytes[], size_t size, void **kept)
{
    const component *c = instance;
    *kept = (size == sizeof(variables)) ? c->functions->allocateMemory(1U, sizeof(variables)) : NULL;
    if (*kept != NULL) {
        memcpy(*kept, bytes, sizeof(variables));
    }
    return (*kept != NULL) ? OK : ERROR;
}

EXPORT fmi2Status fmi2SetDebugLogging(void *c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    (void)c;
    (void)on;
    (void)count;
    (void)categories;
    return OK;
}

EXPORT fmi2Status fmi2SetupExperiment(void *c, fmi2Boolean known, fmi2Real tolerance, fmi2Real start, fmi2Boolean ends, fmi2Real stop)
{
    (void)c;
    (void)known;
    (void)tolerance;
    (void)start;
    (void)ends;
    (void)stop;
    return OK;
}

/* Changes of mode of which an observer takes no notice. */
#define MODE(name)                   \
    EXPORT fmi2Status name(void *c); \
    EXPORT fmi2Status name(void *c)  \
    {                                \
        (void)c;                     \
        return OK;                   \
    }

MODE(fmi2EnterInitializationMode)
MODE(fmi2ExitInitializationMode)
MODE(fmi2Terminate)

/* Variables of types of which there is none. */
#define NO_VARIABLE(name, type)                                                                \
    EXPORT fmi2Status name(void *c, const fmi2ValueReference r[], size_t count, type value[]); \
    EXPORT fmi2Status name(void *c, const fmi2ValueReference r[], size_t count, type value[])  \
    {                                                                                          \
        (void)c;                                                                               \
        (void)r;                                                                               \
        (void)value;                                                                           \
        return (count == 0U) ? OK : ERROR;                                                     \
    }

NO_VARIABLE(fmi2SetInteger, const fmi2Integer)
NO_VARIABLE(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLE(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLE(fmi2GetString, fmi2String)
NO_VARIABLE(fmi2SetString, const fmi2String)

/* What modelDescription.xml does not offer, and nobody may call. */
#define NOT_OFFERED(name)           \
    EXPORT fmi2Status name(void);   \
    EXPORT fmi2Status name(void)    \
    {                               \
        return ERROR;               \
    }

NOT_OFFERED(fmi2GetDirectionalDerivative)
NOT_OFFERED(fmi2SetRealInputDerivatives)
NOT_OFFERED(fmi2GetRealOutputDerivatives)
NOT_OFFERED(fmi2CancelStep)
NOT_OFFERED(fmi2GetStatus)
NOT_OFFERED(fmi2GetRealStatus)
NOT_OFFERED(fmi2GetIntegerStatus)
NOT_OFFERED(fmi2GetBooleanStatus)
NOT_OFFERED(fmi2GetStringStatus)
