/* Plant for the example: @TRAINSET@ as nominal, one control period of @PERIOD@ s at a time. Not for use aboard. */
#ifndef PLANT_H
#define PLANT_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    int32_t section;
@STATE@
} plant_state;

/* Standstill at the origin of a section. */
void plant_init(plant_state *plant, int32_t section);

/* One control period with a command, the emergency brake over it. */
void plant_step(plant_state *plant, @REAL@ share, bool emergency);

#endif
