# Validates a folder of logs: estimates one map from all of them, writes the report, and fails if a log fails a gate.
#
#   make -f lpvobs.mk lpvobs-validate                       on its own, or
#   include lpvobs.mk                                       from your Makefile
#
# A log that cannot be used is named and fails the run as well; the others are still reported. make itself ends with 2 whatever has
# failed; the exit code of each verb stands in exit_codes beside the report: `report 1` is a failed gate, `estimate 3` a bad log. The configuration is lpvobs.toml of
# the working folder unless LPVOBS_CONFIG names another. Everything below can be set on the command line or before the include.

LPVOBS        ?= lpvobs

# A folder, whatever its name; or several folders, logs and patterns, those with spaces in quotes.
LPVOBS_LOGS   ?= logs

LPVOBS_CONFIG ?=
LPVOBS_OUT    ?= build/lpvobs

# A gain that synth-gain has made and proven; without it every run makes one from the logs.
LPVOBS_GAIN   ?=

# Conditions that every log has to meet, without spaces inside. mean_relative_error needs logs with reference channels.
LPVOBS_GATES  ?= share_certified>=0.95 samples>=1000 dropped_rows<=100

lpvobs-quoted = '$(subst ','\'',$(1))'
lpvobs-in-out = $(call lpvobs-quoted,$(LPVOBS_OUT)/$(1))

.PHONY: lpvobs-validate
lpvobs-validate:
	@mkdir -p $(call lpvobs-quoted,$(LPVOBS_OUT))
	@rm -f $(foreach file,map.h5 report.html gates.xml exit_codes,$(call lpvobs-in-out,$(file)))
	@code=0; logs=$(call lpvobs-quoted,$(LPVOBS_LOGS)); \
	if [ -e "$$logs" ]; then set -- "$$logs"; else eval "set -- $$logs"; fi; \
	$(LPVOBS) estimate "$$@" --out $(call lpvobs-in-out,map.h5) \
	  $(if $(LPVOBS_CONFIG),--config $(call lpvobs-quoted,$(LPVOBS_CONFIG))) \
	  $(if $(LPVOBS_GAIN),--gain $(call lpvobs-quoted,$(LPVOBS_GAIN))) || code=$$?; \
	echo "estimate $$code" > $(call lpvobs-in-out,exit_codes); \
	if [ -f $(call lpvobs-in-out,map.h5) ]; then \
	  judged=0; $(LPVOBS) report $(call lpvobs-in-out,map.h5) --html $(call lpvobs-in-out,report.html) \
	    $(foreach gate,$(LPVOBS_GATES),--gate '$(gate)') --junit $(call lpvobs-in-out,gates.xml) || judged=$$?; \
	  echo "report $$judged" >> $(call lpvobs-in-out,exit_codes); \
	  [ $$judged -eq 0 ] || code=$$judged; \
	fi; \
	exit $$code
