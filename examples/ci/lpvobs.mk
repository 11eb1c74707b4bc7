# Validates a folder of logs: estimates one map from all of them, writes the report, and fails if a log fails a gate.
#
#   make -f lpvobs.mk lpvobs-validate                       on its own, or
#   include lpvobs.mk                                       from your Makefile
#
# A log that cannot be used is named and fails the run as well; the others are still reported. The configuration is lpvobs.toml of
# the working folder unless LPVOBS_CONFIG names another. Everything below can be set on the command line or before the include.

LPVOBS        ?= lpvobs
LPVOBS_LOGS   ?= logs
LPVOBS_CONFIG ?=
LPVOBS_OUT    ?= build/lpvobs

# A gain that synth-gain has made and proven; without it every run makes one from the logs.
LPVOBS_GAIN   ?=

# Conditions that every log has to meet, without spaces inside. mean_relative_error needs logs with reference channels.
LPVOBS_GATES  ?= share_certified>=0.95 samples>=1000 dropped_rows<=100

.PHONY: lpvobs-validate
lpvobs-validate:
	@mkdir -p '$(LPVOBS_OUT)'
	@rm -f '$(LPVOBS_OUT)/map.h5' '$(LPVOBS_OUT)/report.html' '$(LPVOBS_OUT)/gates.xml'
	@failed=0; \
	$(LPVOBS) estimate $(LPVOBS_LOGS) --out '$(LPVOBS_OUT)/map.h5' \
	  $(if $(LPVOBS_CONFIG),--config '$(LPVOBS_CONFIG)') $(if $(LPVOBS_GAIN),--gain '$(LPVOBS_GAIN)') || failed=1; \
	if [ -f '$(LPVOBS_OUT)/map.h5' ]; then \
	  $(LPVOBS) report '$(LPVOBS_OUT)/map.h5' --html '$(LPVOBS_OUT)/report.html' \
	    $(foreach gate,$(LPVOBS_GATES),--gate '$(gate)') --junit '$(LPVOBS_OUT)/gates.xml' || failed=1; \
	fi; \
	exit $$failed
